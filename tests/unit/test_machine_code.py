"""The machine code of kernels on disk: when it is used, and what becomes of damaged or unusable files."""

import fcntl
import importlib
import os
import resource
import sys
import time
from typing import NamedTuple

import numba
import pytest

from rover_ncp.core.errors import UsageError
from rover_ncp.kernels import machine_code
from rover_ncp.kernels.jit import kernel
from sim.world import chipmunk, fleet


@pytest.fixture
def fresh(monkeypatch, tmp_path):
    """The module as at the start of a process, with a folder of its own."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(machine_code, "_reported", [])
    machine_code._folder.cache_clear()
    yield tmp_path
    machine_code._folder.cache_clear()


def double(x):
    return 2.0 * x


def triple(x):
    return 3.0 * x


def run(capsys):
    """Compile or load a kernel as a process that starts; return (value, cache hits, stderr)."""
    machine_code._reported.clear()
    compiled = kernel(double)
    value = compiled(10.0)
    return value, sum(compiled.stats.cache_hits.values()), capsys.readouterr().err


def code_file():
    [file] = machine_code._folder().glob("*.code")
    return file


def flip(code):
    middle = len(code) // 2
    return code[:middle] + bytes([code[middle] ^ 1]) + code[middle + 1 :]


@pytest.mark.parametrize(
    "damage",
    [lambda code: b"", lambda code: code[: len(code) // 2], lambda code: os.urandom(5000), flip],
    ids=["empty", "cut", "random", "one bit"],
)
def test_damaged_machine_code_is_made_anew_with_one_line(damage, fresh, capsys):
    assert run(capsys) == (20.0, 0, "")
    file = code_file()
    file.write_bytes(damage(file.read_bytes()))
    assert run(capsys) == (20.0, 0, f"rover-ncp: {file}: is damaged; the kernel is compiled anew\n")
    assert run(capsys) == (20.0, 1, "")


def test_folder_in_place_of_machine_code_is_one_line(fresh, capsys):
    run(capsys)
    file = code_file()
    file.unlink()
    file.mkdir()
    said = f"rover-ncp: {file}: cannot be used: Is a directory; the kernel is compiled anew\n"
    assert run(capsys) == (20.0, 0, said)


@pytest.mark.parametrize(
    ("folder", "problem"),
    [("/dev/null", f"/dev/null/rover-ncp-{os.geteuid()}: Not a directory"), ("", "/dev/null/.cache")],
)
def test_kernels_run_where_there_can_be_no_folder(folder, problem, fresh, monkeypatch, capsys):
    monkeypatch.setattr(numba.config, "CACHE_DIR", folder)
    monkeypatch.setenv("XDG_CACHE_HOME", "")
    monkeypatch.setenv("HOME", "/dev/null")
    value, hits, errors = run(capsys)
    assert (value, hits, errors.count("\n")) == (20.0, 0, 1)
    assert errors.startswith(f"rover-ncp: {problem}")
    assert ": kernels are compiled at each start" in errors


def test_full_disk_is_one_line_that_names_the_file(fresh, capsys):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (512, limits[1]))
    try:
        value, hits, errors = run(capsys)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert (value, hits, errors.count("\n")) == (20.0, 0, 1)
    assert ".code: cannot be written: File too large; kernels are compiled at each start" in errors
    assert list(fresh.rglob("*.code")) == []


def test_each_user_has_a_folder_and_reads_none_that_another_can_write(fresh, monkeypatch, capsys):
    own = machine_code._folder()
    with monkeypatch.context() as patch:
        patch.setattr(os, "geteuid", lambda: 12345)
        (fresh / "rover-ncp-12345").mkdir()
        machine_code._folder.cache_clear()
        assert machine_code._folder() is None
    own.chmod(0o707)
    machine_code._folder.cache_clear()
    assert machine_code._folder() is None
    assert "another user can write there" in capsys.readouterr().err


def test_machine_code_that_nobody_used_for_long_is_removed(fresh):
    old, used = (machine_code._folder() / name for name in ("old.code", "used.code"))
    old.touch()
    used.touch()
    os.utime(old, (0, time.time() - machine_code.MAX_AGE_S - 10.0))
    machine_code._folder.cache_clear()
    machine_code._folder()
    assert (old.exists(), used.exists()) == (False, True)


def test_a_process_that_keeps_its_lock_holds_up_others_for_a_limited_time(fresh, monkeypatch):
    monkeypatch.setattr(machine_code, "WAIT_S", 0.2)
    compiled = kernel(double)
    lock = compiled._cache.path((numba.float64,)).with_suffix(".lock")
    with lock.open("wb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        began = time.monotonic()
        assert compiled(10.0) == 20.0
        assert time.monotonic() - began >= 0.2


def test_lock_that_cannot_be_made_holds_up_nothing(fresh, capsys):
    kernel(double)._cache.path((numba.float64,)).with_suffix(".lock").mkdir()
    assert run(capsys) == (20.0, 0, "")


def test_disabled_compiler_is_an_error(monkeypatch):
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
    monkeypatch.delitem(sys.modules, "rover_ncp.kernels.jit")
    with pytest.raises(UsageError, match="NUMBA_DISABLE_JIT is set"):
        importlib.import_module("rover_ncp.kernels.jit")


# -- what names a file -------------------------------------------------------------------------------------


def path_of(function, argument=numba.float64):
    return kernel(function)._cache.path((argument,))


def test_renamed_class_or_field_of_an_argument_is_another_file(fresh):
    def path_for(name, field):
        return path_of(double, numba.typeof(NamedTuple(name, [(field, float)])(1.0)))

    assert path_for("Pair", "x") == path_for("Pair", "x")
    assert len({path_for(*names) for names in (("Pair", "x"), ("Couple", "x"), ("Couple", "y"))}) == 3


def test_another_free_variable_of_a_factory_is_another_file(fresh):
    def make(called, offset):
        def made(x):
            return called(x) + offset

        return made

    inner = kernel(double)
    assert path_of(make(inner, 1.0)) == path_of(make(inner, 1.0))
    others = [make(inner, 1.0), make(inner, 2.0), make(kernel(triple), 1.0)]
    others.append(make(kernel(others[0]), 1.0))
    assert len({path_of(made) for made in others}) == len(others)


@pytest.mark.parametrize(
    "line",
    [
        "from kernels_of_mine.callee import FACTOR",
        "from kernels_of_mine import callee",
        "from kernels_of_mine import (\n    other,  # (unused)\n    callee as named,\n)",
        "from . import callee",
        "from .callee import FACTOR",
        "import numpy, kernels_of_mine.callee as named",
        "try:\n    from kernels_of_mine import callee\nexcept ImportError:\n    pass",
    ],
)
def test_changed_module_that_is_imported_is_another_file(line, fresh, monkeypatch):
    monkeypatch.syspath_prepend(fresh)
    folder = fresh / "kernels_of_mine"
    folder.mkdir()
    for name in ("__init__", "other", "callee"):
        (folder / f"{name}.py").write_text("FACTOR = 2.0\n")
    (folder / "caller.py").write_text(f"{line}\ndef scaled(x):\n    return 2.0 * x\n")
    for name in ("", ".caller", ".callee", ".other"):
        monkeypatch.delitem(sys.modules, f"kernels_of_mine{name}", raising=False)
    importlib.invalidate_caches()
    scaled = importlib.import_module("kernels_of_mine.caller").scaled

    first = path_of_code(scaled)
    assert path_of_code(scaled) == first
    (folder / "callee.py").write_text("FACTOR = 3.0\n")
    assert path_of_code(scaled) != first


def path_of_code(function):
    """Return the path as a process that starts has it."""
    machine_code._sources.cache_clear()
    machine_code._source.cache_clear()
    return path_of(function)


def test_machine_code_of_the_fleet_depends_on_the_calls_into_chipmunk(monkeypatch):
    digest, source = machine_code._sources.__wrapped__, machine_code._source
    first = digest(fleet.__name__)
    monkeypatch.setattr(
        machine_code, "_source", lambda path: source(path) + (b"#" if path == chipmunk.__file__ else b"")
    )
    assert digest(fleet.__name__) != first
