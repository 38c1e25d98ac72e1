import fcntl
import importlib
import os
import subprocess
import sys
import time

import pytest

from rover_ncp.kernels import machine_code
from rover_ncp.kernels.jit import kernel

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
def make(called, offset):
    @kernel
    def made(x):
        return called(x) + offset
    return made
def main():
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


def run(folder, factor, environment=None, count=1, caller=CALLER, prefix=()):
    """Run the kernels in so many processes that begin together; return (value, cache hits, stderr)."""
    (folder / "mine").mkdir(exist_ok=True)
    (folder / "mine" / "callee.py").write_text(CALLEE.format(factor=factor))
    (folder / "mine" / "caller.py").write_text(caller)
    own = {
        "PYTHONPATH": str(folder),
        "PYTHONDONTWRITEBYTECODE": "1",
        "NUMBA_CACHE_DIR": str(folder / "cache"),
    }
    processes = [
        subprocess.Popen(
            [*prefix, sys.executable, "-c", "from mine.caller import main; main()"],
            cwd=folder,
            env=os.environ | own | (environment or {}),
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


def files(folder):
    return sorted((folder / "cache").glob("*/*.code"))


@pytest.mark.long
def test_machine_code_is_kept_until_something_in_it_changes(tmp_path):
    assert run(tmp_path, 2.0) == [(42.0, 0, "")]
    assert run(tmp_path, 2.0) == [(42.0, 1, "")]
    # The caller's own file is the same, but what it calls and the constant it reads are not.
    assert run(tmp_path, 3.0) == [(63.0, 0, "")]


@pytest.mark.long
def test_kernels_of_a_factory_are_kept_until_a_free_variable_changes(tmp_path):
    def run_made(factor):
        return run(tmp_path, factor, caller=FACTORY)

    # 10 f + f, and 10 f + 1 + 2
    assert run_made(2.0) == [(45.0, 0, "")]
    assert run_made(2.0) == [(45.0, 1, "")]
    assert run_made(3.0) == [(66.0, 0, "")]
    assert run_made(2.0) == [(45.0, 1, "")]


RENAMED = """
from typing import NamedTuple
from rover_ncp.kernels.jit import kernel
class {0}(NamedTuple):
    {1}: float
@kernel
def outer(pair):
    return 2.0 * pair.{1}
def main():
    print("ready", flush=True)
    input()
    print(outer({0}(10.0)), sum(outer.stats.cache_hits.values()))
"""


def test_a_renamed_class_of_an_argument_compiles_anew(tmp_path):
    for name, field, hits in (("Pair", "x", 0), ("Pair", "x", 1), ("Couple", "x", 0), ("Couple", "y", 0)):
        assert run(tmp_path, 2.0, caller=RENAMED.format(name, field)) == [(20.0, hits, "")]


@pytest.fixture
def fresh(monkeypatch, tmp_path):
    """The module as at the start of a process, with a folder of its own."""
    monkeypatch.setattr(machine_code.numba.config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(machine_code, "_reported", [])
    machine_code._folder.cache_clear()
    yield tmp_path
    machine_code._folder.cache_clear()


def empty(file):
    file.write_bytes(b"")


def cut(file):
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def garble(file):
    file.write_bytes(os.urandom(5000))


def flip(file):
    content = bytearray(file.read_bytes())
    content[len(content) * 3 // 4] ^= 1
    file.write_bytes(content)


def zero_the_end(file):
    size = file.stat().st_size
    file.write_bytes(file.read_bytes()[: size // 2] + bytes(size - size // 2))


def make_folder(file):
    file.unlink()
    file.mkdir()


def double(x):
    return 2.0 * x


def fresh_kernel(capsys):
    """Compile or load a kernel as a process that starts; return (value, cache hits, stderr)."""
    machine_code._reported.clear()
    compiled = kernel(double)
    value = compiled(10.0)
    return value, sum(compiled.stats.cache_hits.values()), capsys.readouterr().err


@pytest.mark.parametrize("damage", [empty, cut, garble, flip, zero_the_end])
def test_damaged_machine_code_is_made_anew_with_one_line(damage, fresh, capsys):
    assert fresh_kernel(capsys) == (20.0, 0, "")
    [file] = machine_code._folder().glob("*.code")
    damage(file)
    said = f"rover-ncp: {file}: is damaged; the kernel is compiled anew\n"
    assert fresh_kernel(capsys) == (20.0, 0, said)
    assert fresh_kernel(capsys) == (20.0, 1, "")


def test_folder_in_place_of_machine_code_is_one_line(fresh, capsys):
    fresh_kernel(capsys)
    [file] = machine_code._folder().glob("*.code")
    make_folder(file)
    said = f"rover-ncp: {file}: cannot be used: Is a directory; the kernel is compiled anew\n"
    assert fresh_kernel(capsys) == (20.0, 0, said)


# Root may read and write everything, unless it gives up the capabilities for it.
AS_ANYBODY = ["setpriv", "--bounding-set=-dac_override,-dac_read_search"] if os.geteuid() == 0 else []


def test_read_only_machine_code_is_used_and_unreadable_is_compiled_with_one_line(tmp_path):
    run(tmp_path, 2.0)
    folder = files(tmp_path)[0].parent
    folder.chmod(0o500)
    try:
        assert run(tmp_path, 2.0, prefix=AS_ANYBODY) == [(42.0, 1, "")]
        [(value, hits, errors)] = run(tmp_path, 3.0, prefix=AS_ANYBODY)
        assert (value, hits, errors.count("\n")) == (63.0, 0, 1)
        assert "cannot be written: Permission denied; kernels are compiled at each start" in errors
        for file in files(tmp_path):
            file.chmod(0)
        [(value, hits, errors)] = run(tmp_path, 2.0, prefix=AS_ANYBODY)
        assert (value, hits, errors.count("\n")) == (42.0, 0, 1)
        assert "cannot be used: Permission denied" in errors
    finally:
        folder.chmod(0o700)


@pytest.mark.parametrize(
    ("environment", "words"),
    [
        ({"NUMBA_CACHE_DIR": "/dev/null"}, "/dev/null/rover-ncp-{}: Not a directory: kernels are compiled"),
        ({"NUMBA_CACHE_DIR": "", "XDG_CACHE_HOME": "", "HOME": "/dev/null"}, "/dev/null/.cache"),
    ],
)
def test_kernels_run_where_nothing_can_be_written(environment, words, tmp_path):
    [(value, hits, errors)] = run(tmp_path, 2.0, environment)
    assert (value, hits, errors.count("\n")) == (42.0, 0, 1)
    assert errors.startswith("rover-ncp: " + words.format(os.geteuid()))


def test_full_disk_is_one_line_that_names_the_file(tmp_path):
    limit = ["sh", "-c", 'ulimit -f 1; exec "$@"', "sh"]
    [(value, hits, errors)] = run(tmp_path, 2.0, prefix=limit)
    assert (value, hits, errors.count("\n")) == (42.0, 0, 1)
    assert "cannot be written: File too large; kernels are compiled at each start" in errors
    assert files(tmp_path) == []


def test_each_user_has_a_folder_and_reads_none_that_another_can_write(fresh, monkeypatch, capsys):
    own = machine_code._folder()
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    theirs = fresh / "rover-ncp-12345"
    theirs.mkdir()
    machine_code._folder.cache_clear()
    assert machine_code._folder() is None
    monkeypatch.undo()
    monkeypatch.setattr(machine_code.numba.config, "CACHE_DIR", str(fresh))
    own.chmod(0o707)
    machine_code._folder.cache_clear()
    assert machine_code._folder() is None
    assert capsys.readouterr().err.count("another user can write there") >= 1


def test_machine_code_that_nobody_used_for_long_is_removed(fresh):
    old, used = (machine_code._folder() / name for name in ("old.code", "used.code"))
    old.touch()
    used.touch()
    os.utime(old, (0, time.time() - machine_code.MAX_AGE_S - 10.0))
    machine_code._folder.cache_clear()
    machine_code._folder()
    assert (old.exists(), used.exists()) == (False, True)


def test_disabled_compiler_is_one_line():
    done = subprocess.run(
        [sys.executable, "-m", "rover_ncp", "eval", "parking"],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert done.stderr.startswith("rover-ncp: NUMBA_DISABLE_JIT is set")


def test_processes_that_start_together_compile_once(tmp_path):
    assert sorted(run(tmp_path, 2.0, count=2)) == [(42.0, 0, ""), (42.0, 1, "")]


def test_a_process_that_keeps_its_lock_holds_up_others_for_a_limited_time(fresh, monkeypatch):
    (fresh / "locked_kernel.py").write_text(CALLEE.format(factor=2.0))
    monkeypatch.syspath_prepend(fresh)
    monkeypatch.setattr(machine_code, "WAIT_S", 0.2)
    inner = importlib.import_module("locked_kernel").inner
    lock = inner._cache.path((machine_code.numba.float64,)).with_suffix(".lock")
    with lock.open("wb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        began = time.monotonic()
        assert inner(10.0) == 20.0
        assert time.monotonic() - began >= 0.2
