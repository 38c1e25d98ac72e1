"""Exported C in place of the solver, in the stack simulation."""

import ctypes
import shutil

import pytest
from kit.c_policy import CPolicy, compile_c

from deploy.drive import controller
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.course.course import load_course
from rover_ncp.export.c_sources import c_files
from sim.learn.policies import load_driver
from sim.stack.trials import Stack, drive_all
from sim.world.randomization import load_randomization

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
TRIALS = 4


def stack():
    return Stack(load_driver("course"), (load_course("parking"),), load_randomization("full"), 1)


@pytest.fixture
def drive_in_c(monkeypatch, tmp_path):
    """Drive trials with the exported policy as double or float."""

    def drive(count, real, *options):
        files = c_files(load_policy("course"), "course", load_course("parking"))
        library = compile_c(files, tmp_path / real.__name__, "p.so", "-shared", "-fPIC", *options)
        monkeypatch.setattr(controller, "Runner", lambda p: CPolicy(p, library, "course", real))
        return drive_all(stack().drive, count, 1)

    return drive


def test_exported_c_drives_as_the_original(drive_in_c):
    original = drive_all(stack().drive, TRIALS, 1)
    assert all(trial.parked for trial in original)
    assert drive_in_c(TRIALS, ctypes.c_double) == original
    for trial, other in zip(drive_in_c(TRIALS, ctypes.c_float, "-DROVER_NCP_FLOAT"), original, strict=True):
        assert trial.parked
        assert trial.error_m == pytest.approx(other.error_m, abs=0.01)
