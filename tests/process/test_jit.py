import fcntl
import importlib
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

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
def make(called, offset):
    @kernel
    def made(x):
        return called(x) + offset
    return made
if __name__ == "__main__":
    print("ready", flush=True)
    input()
    print(outer(10.0), sum(outer.stats.cache_hits.values()))
"""
FACTORY = (
    CALLER.replace("outer(10.0)", "made(10.0) + twice(10.0)")
    .replace("outer.stats", "made.stats")
    .replace(
        'print("ready"', 'made, twice = make(inner, FACTOR), make(make(inner, 1.0), 2.0)\n    print("ready"'
    )
)
COMMAND = [sys.executable, "-c", "import runpy; runpy.run_path('caller.py', run_name='__main__')"]


def run(folder, factor, environment=None, count=1, caller=CALLER, command=COMMAND):
    """Run the kernels in so many processes that begin together; return (value, cache hits) of each."""
    (folder / "callee.py").write_text(CALLEE.format(factor=factor))
    (folder / "caller.py").write_text(caller)
    path = {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    processes = [
        subprocess.Popen(
            command,
            cwd=folder,
            env=os.environ | path | (environment or {}),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for _ in range(count)
    ]
    results = []
    try:
        for process in processes:
            assert process.stdout.readline() == "ready\n"
        for process in processes:
            process.stdin.write("\n")
            process.stdin.flush()
        for process in processes:
            value, hits = process.communicate(timeout=60)[0].split()
            results.append((float(value), int(hits)))
    finally:
        for process in processes:
            process.kill()
            process.communicate()
    return results


@pytest.mark.long
def test_machine_code_is_kept_until_something_in_it_changes(tmp_path):
    assert run(tmp_path, 2.0) == [(42.0, 0)]
    assert run(tmp_path, 2.0) == [(42.0, 1)]
    # The caller's own file is the same, but what it calls and the constant it reads are not.
    assert run(tmp_path, 3.0) == [(63.0, 0)]


@pytest.mark.long
def test_kernels_of_a_factory_are_kept_until_a_free_variable_changes(tmp_path):
    def run_made(factor):
        return run(tmp_path, factor, caller=FACTORY)

    # 10 f + f, and 10 f + 1 + 2
    assert run_made(2.0) == [(45.0, 0)]
    assert run_made(2.0) == [(45.0, 1)]
    assert run_made(3.0) == [(66.0, 0)]
    assert run_made(2.0) == [(45.0, 1)]


def test_a_renamed_class_of_an_argument_compiles_anew(tmp_path):
    caller = """
from typing import NamedTuple
from rover_ncp.kernels.jit import kernel
class {0}(NamedTuple):
    x: float
@kernel
def outer(pair):
    return 2.0 * pair.x
print("ready", flush=True)
input()
print(outer({0}(10.0)), sum(outer.stats.cache_hits.values()))
"""
    command = [sys.executable, "-c", "import caller"]
    for name, hits in (("Pair", 0), ("Pair", 1), ("Couple", 0), ("Couple", 1)):
        assert run(tmp_path, 2.0, caller=caller.format(name), command=command) == [(20.0, hits)]


def test_kernels_run_where_nothing_can_be_written(tmp_path):
    # A file where a folder should be: no cache folder can be made, not even by root.
    (tmp_path / "__pycache__").write_text("")
    nowhere = {"HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null"}
    assert run(tmp_path, 2.0, nowhere) == [(42.0, 0)]


def test_processes_that_start_together_compile_once(tmp_path):
    assert sorted(run(tmp_path, 2.0, count=2)) == [(42.0, 0), (42.0, 1)]


def test_a_process_that_keeps_its_lock_holds_up_others_for_a_limited_time(tmp_path, monkeypatch):
    (tmp_path / "locked_kernel.py").write_text(CALLEE.format(factor=2.0))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("rover_ncp.kernels.jit.WAIT_S", 0.2)
    inner = importlib.import_module("locked_kernel").inner
    lock = Path(f"{inner._cache._cache_file._index_path}.lock")
    lock.parent.mkdir(parents=True, exist_ok=True)
    with lock.open("wb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        began = time.monotonic()
        assert inner(10.0) == 20.0
        assert time.monotonic() - began >= 0.2
