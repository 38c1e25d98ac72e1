"""Machine code that processes share: who compiles, who loads, and what a folder without rights does."""

import os
import subprocess
import sys

import pytest

CALLEE = """
from rover_ncp.kernels.jit import kernel
FACTOR = {factor}
@kernel
def inner(x):
    return x * {factor}
"""
CALLER = """
import mine.callee
from mine.callee import FACTOR, inner
from rover_ncp.kernels.jit import kernel
@kernel
def outer(x):
    return middle(x) + FACTOR + mine.callee.inner(x)
@kernel
def middle(x):
    return last(x)
@kernel
def last(x):
    return inner(x)
def main():
    print("ready", flush=True)
    input()
    print(outer(10.0), sum(outer.stats.cache_hits.values()))
"""


def run(folder, factor, count=1, prefix=()):
    """Run the kernels in so many processes that begin together; return (value, cache hits, stderr)."""
    (folder / "mine").mkdir(exist_ok=True)
    (folder / "mine" / "callee.py").write_text(CALLEE.format(factor=factor))
    (folder / "mine" / "caller.py").write_text(CALLER)
    own = {
        "PYTHONPATH": str(folder),
        "PYTHONDONTWRITEBYTECODE": "1",
        "NUMBA_CACHE_DIR": str(folder / "cache"),
    }
    processes = [
        subprocess.Popen(
            [*prefix, sys.executable, "-c", "from mine.caller import main; main()"],
            cwd=folder,
            env=os.environ | own,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for _ in range(count)
    ]
    results = []
    try:
        for process in processes:
            assert process.stdout.readline() == "ready\n", process.stderr.read()
        for process in processes:
            process.stdin.write("\n")
            process.stdin.flush()
        for process in processes:
            printed, errors = process.communicate(timeout=120)
            value, hits = printed.split()
            results.append((float(value), int(hits), errors))
    finally:
        for process in processes:
            process.kill()
            process.communicate()
    return results


def test_processes_that_start_together_compile_once(tmp_path):
    assert sorted(run(tmp_path, 2.0, count=2)) == [(42.0, 0, ""), (42.0, 1, "")]


# Root may read and write everything, unless it gives up the capabilities for it.
AS_ANYBODY = ["setpriv", "--bounding-set=-dac_override,-dac_read_search"] if os.geteuid() == 0 else []


@pytest.mark.long
def test_read_only_machine_code_is_used_and_unreadable_is_compiled_with_one_line(tmp_path):
    run(tmp_path, 2.0)
    [folder] = (tmp_path / "cache").iterdir()
    folder.chmod(0o500)
    try:
        assert run(tmp_path, 2.0, prefix=AS_ANYBODY) == [(42.0, 1, "")]
        [(value, hits, errors)] = run(tmp_path, 3.0, prefix=AS_ANYBODY)
        assert (value, hits, errors.count("\n")) == (63.0, 0, 1)
        assert "cannot be written: Permission denied; kernels are compiled at each start" in errors
        for file in folder.glob("*.code"):
            file.chmod(0)
        [(value, hits, errors)] = run(tmp_path, 2.0, prefix=AS_ANYBODY)
        assert (value, hits, errors.count("\n")) == (42.0, 0, 1)
        assert "cannot be used: Permission denied" in errors
    finally:
        folder.chmod(0o700)
