import os
import subprocess
import sys

CALLEE = """
from rover_ncp.kernels.jit import kernel
FACTOR = {factor}
@kernel
def inner(x):
    return x * {factor}
"""
CALLER = """
import callee
from callee import FACTOR, inner
from rover_ncp.kernels.jit import kernel
@kernel
def outer(x):
    return middle(x) + FACTOR + callee.inner(x)
@kernel
def middle(x):
    return last(x)
@kernel
def last(x):
    return inner(x)
if __name__ == "__main__":
    print(outer(10.0), sum(outer.stats.cache_hits.values()))
"""


def run(folder, factor, environment=None):
    (folder / "callee.py").write_text(CALLEE.format(factor=factor))
    (folder / "caller.py").write_text(CALLER)
    command = [sys.executable, "-c", "import runpy; runpy.run_path('caller.py', run_name='__main__')"]
    path = {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        command,
        cwd=folder,
        env=os.environ | path | (environment or {}),
        capture_output=True,
        check=True,
        timeout=60,
        text=True,
    )
    value, hits = done.stdout.split()
    return float(value), int(hits)


def test_machine_code_is_kept_until_something_in_it_changes(tmp_path):
    assert run(tmp_path, 2.0) == (42.0, 0)
    assert run(tmp_path, 2.0) == (42.0, 1)
    # The caller's own file is the same, but what it calls and the constant it reads are not.
    assert run(tmp_path, 3.0) == (63.0, 0)


def test_kernels_run_where_nothing_can_be_written(tmp_path):
    # A file where a folder should be: no cache folder can be made, not even by root.
    (tmp_path / "__pycache__").write_text("")
    nowhere = {"HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null"}
    assert run(tmp_path, 2.0, nowhere) == (42.0, 0)
