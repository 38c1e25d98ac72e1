"""Exported C, compiled with gcc, against the solver and the reference."""

import ctypes
import math
import re
import shutil
import subprocess
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path

import numpy as np
import pytest
from kit.c_policy import CCourse, CPolicy, compile_c

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.circuit.runner import Runner
from rover_ncp.core.files import resolve
from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import TICK_S, load_course
from rover_ncp.course.reference import plan_reference
from rover_ncp.course.signals import SIGNALS, signals
from rover_ncp.export.c_sources import c_files

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
COURSE = load_policy("course")
PARKING = load_course("parking")
LIBRARY = "p.so", "-shared", "-fPIC"
FLOAT = "-DROVER_NCP_FLOAT"


@pytest.fixture(scope="module", params=["course", "parking"])
def shipped(request, tmp_path_factory):
    """A shipped policy, its name, and the library of its sources for a course."""
    policy = load_policy(request.param)
    files = c_files(policy, request.param, PARKING)
    return policy, request.param, compile_c(files, tmp_path_factory.mktemp(request.param), *LIBRARY)


def random_observations(policy, count, seed=3):
    """Numbers within twice the ranges, and now and then far beyond any."""
    generator = np.random.default_rng(seed)
    ranges = 2 * np.array(policy.sensing.ranges or np.ones(len(policy.sensing.inputs)))
    found = generator.uniform(-ranges, ranges, (count, len(ranges)))
    found[:: count // 20] *= 10.0 ** generator.uniform(1, 300, found[:: count // 20].shape)
    return found


def test_random_ticks_agree_with_the_solver_to_the_last_bit(shipped):
    policy, name, library = shipped
    c, solver = CPolicy(policy, library, name), Runner(policy)
    for observation in random_observations(policy, 3000):
        assert c.tick(observation) == solver.tick(observation)
    assert c.potentials.tobytes() == solver.potentials.tobytes()


def test_float_stays_near_the_solver(tmp_path):
    policy, files = COURSE, c_files(COURSE, "course", PARKING)
    sources = {file: text for file, text in files.items() if not file.endswith("_check.c")}
    library = compile_c(sources, tmp_path, *LIBRARY, FLOAT, "-Wdouble-promotion")
    c, solver = CPolicy(policy, library, "course", ctypes.c_float), Runner(policy)
    observations = np.clip(random_observations(policy, 3000), -1e3, 1e3)
    found = np.array([(c.tick(row), solver.tick(row)) for row in observations])
    # A thousandth of the slowest command that a base carries out, 1 mm/s or 1 deg/s.
    assert np.abs(found[:, 0] - found[:, 1]).max() < 1e-5


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_an_observation_that_is_not_finite_gives_no_command_and_leaves_the_state(wrong, shipped):
    policy, name, library = shipped
    c, seen = CPolicy(policy, library, name), [0.1] * len(policy.sensing.inputs)
    c.tick(seen)
    before = c.potentials
    assert c.try_tick([*seen[1:], wrong]) == (-1, (0.0, 0.0))
    assert c.potentials.tobytes() == before.tobytes()


@pytest.mark.parametrize(
    ("name", "course", "first"),
    [
        ("course", "reverse", None),
        *(("course", "parking", first) for first in range(0, len(SIGNALS), len(COURSE.sensing.inputs))),
    ],
)
def test_the_course_shows_what_a_policy_sees_in_the_simulator(name, course, first, tmp_path):
    policy, known = load_policy(name), load_course(course)
    if first is not None:  # every signal, also those that no shipped policy observes
        inputs = tuple(islice(cycle(SIGNALS), first, first + len(policy.sensing.inputs)))
        policy = replace(policy, sensing=policy.sensing.model_copy(update={"inputs": inputs}))
    library = compile_c(c_files(policy, name, known), tmp_path, *LIBRARY)
    c = CCourse(policy, library, name)
    reference = plan_reference(known) if name == "course" else None
    chosen = [SIGNALS.index(signal) for signal in policy.sensing.inputs]
    generator = np.random.default_rng(1)
    for tick in range(-1, known.ticks + 20):
        where = reference.tick(max(tick, 0)) if reference else None
        pose = Pose(*generator.normal(0, 1, 2), generator.uniform(-math.pi, math.pi))
        values = signals(pose, known.start_signal(tick * TICK_S) if tick >= 0 else 0.0, where)
        np.testing.assert_allclose(c.observe(pose), [values[i] for i in chosen], rtol=0, atol=1e-9)
        c.advance()


@pytest.mark.parametrize("real", [(), (FLOAT,)], ids=["double", "float"])
def test_check_of_a_build_passes_and_finds_another_circuit(real, tmp_path):
    policy, name = COURSE, "course"
    layout = policy.layout()
    other = policy.with_parameters(np.clip(policy.parameters() * 1.01, layout.lower, layout.upper))
    files = c_files(policy, name, PARKING)
    for circuit, code in ((policy, 0), (other, 1)):
        changed = c_files(circuit, name, PARKING)[f"{name}.c"]
        check = compile_c(files | {f"{name}.c": changed}, tmp_path / str(code), "check", *real)
        assert subprocess.run([check], capture_output=True, timeout=10, check=False).returncode == code


@pytest.mark.parametrize("tick", [0, -1])
def test_check_of_a_build_finds_a_command_that_is_no_number(tick, tmp_path):
    files = c_files(COURSE, "course", PARKING)
    before, table = files["course_check.c"].rsplit("commands[TICKS]", 1)
    rows = re.findall(r"\{([^{}]+)\},", table)
    damaged = table.replace(rows[tick], "NAN, " + rows[tick].split(", ", 1)[1])
    check = compile_c(files | {"course_check.c": f"{before}commands[TICKS]{damaged}"}, tmp_path, "check")
    done = subprocess.run([check], capture_output=True, timeout=10, check=False, text=True)
    assert (done.returncode, "commands within nan" in done.stdout.replace("-nan", "nan")) == (1, True)


def test_the_command_writes_files_that_compile_and_names_them(tmp_path, run_json):
    path, name = tmp_path / "2nd-try.v3.yaml", "policy_2nd_try_v3"
    shutil.copy(resolve("policies", "course"), path)
    code, fields = run_json(f"export {path} --to c --out {tmp_path / 'new'}")
    assert code == 0
    files = {Path(file).name: Path(file).read_text() for file in fields["files"]}
    endings = (".h", ".c", "_check.c")
    assert files.keys() == {f"{name}{ending}" for ending in endings}
    compile_c(files, tmp_path / "built", "check")
