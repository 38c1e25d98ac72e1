"""Exported C, compiled with gcc, against the solver and the reference."""

import ctypes
import json
import math
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kit.c_policy import CCourse, CPolicy, compile_c
from kit.wirings import wirings

from rover_ncp.circuit.policy_file import load_policy, policy_to_yaml
from rover_ncp.circuit.runner import Runner
from rover_ncp.cli import run
from rover_ncp.core.files import resolve
from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import TICK_S, load_course
from rover_ncp.course.reference import plan_reference
from rover_ncp.course.signals import SIGNALS, signals
from rover_ncp.export.circuit_c import circuit_files
from rover_ncp.export.export import exported

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
POLICIES = ("course", "parking", "reverse")


@pytest.fixture(scope="module", params=POLICIES)
def shipped(request, tmp_path_factory):
    """A shipped policy, its name, and its sources for a course."""
    policy = load_policy(request.param)
    return policy, request.param, exported(policy, "c", request.param, load_course("parking"))


def random_observations(policy, count, seed=3):
    """Numbers within twice the ranges, and now and then far beyond any."""
    generator = np.random.default_rng(seed)
    ranges = 2 * np.array(policy.sensing.ranges or np.ones(len(policy.sensing.inputs)))
    found = generator.uniform(-ranges, ranges, (count, len(ranges)))
    found[:: count // 20] *= 10.0 ** generator.uniform(1, 300, found[:: count // 20].shape)
    return found


def test_ten_thousand_random_ticks_agree_with_the_solver_to_the_last_bit(shipped, tmp_path):
    policy, name, _ = shipped
    library = compile_c(circuit_files(policy, name, "test"), tmp_path, "p.so", "-shared", "-fPIC")
    c, solver = CPolicy(policy, library, name), Runner(policy)
    for observation in random_observations(policy, 10_000):
        assert c.tick(observation) == solver.tick(observation)
    assert c.potentials.tobytes() == solver.potentials.tobytes()


@settings(max_examples=20, deadline=None)
@given(policy=wirings(), seed=st.integers(0, 2**32))
def test_any_wiring_compiles_and_agrees_to_the_last_bit(policy, seed, tmp_path_factory):
    files = circuit_files(policy, "any", "test")
    library = compile_c(files, tmp_path_factory.mktemp("any"), "p.so", "-shared", "-fPIC")
    c, solver = CPolicy(policy, library, "any"), Runner(policy)
    for observation in random_observations(policy, 100, seed):
        assert c.tick(observation) == solver.tick(observation)


def test_float_stays_near_the_solver(shipped, tmp_path):
    policy, name, _ = shipped
    files = circuit_files(policy, name, "test")
    library = compile_c(
        files, tmp_path, "p.so", "-shared", "-fPIC", "-DROVER_NCP_FLOAT", "-Wdouble-promotion"
    )
    c, solver = CPolicy(policy, library, name, ctypes.c_float), Runner(policy)
    observations = np.clip(random_observations(policy, 10_000), -1e3, 1e3)
    found = np.array([(c.tick(row), solver.tick(row)) for row in observations])
    # A thousandth of the slowest command that a base carries out, 1 mm/s or 1 deg/s.
    assert np.abs(found[:, 0] - found[:, 1]).max() < 1e-5


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_an_observation_that_is_not_finite_gives_no_command_and_leaves_the_state(wrong, tmp_path):
    policy = load_policy("course")
    library = compile_c(circuit_files(policy, "course", "test"), tmp_path, "p.so", "-shared", "-fPIC")
    c = CPolicy(policy, library, "course")
    c.tick([0.1] * 5)
    before = c.potentials
    assert c.try_tick([0.1, 0.1, 0.1, 0.1, wrong]) == (-1, (0.0, 0.0))
    assert c.potentials.tobytes() == before.tobytes()


@pytest.mark.parametrize(
    ("name", "course"), [("course", "parking"), ("course", "reverse"), ("parking", "parking")]
)
def test_the_course_shows_what_a_policy_sees_in_the_simulator(name, course, tmp_path):
    policy, known = load_policy(name), load_course(course)
    files = exported(policy, "c", name, known)
    library = compile_c(files, tmp_path, "p.so", "-shared", "-fPIC")
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


@pytest.mark.parametrize("options", [(), ("-DROVER_NCP_FLOAT",)])
def test_the_check_of_a_build_passes_and_finds_another_circuit(shipped, options, tmp_path):
    policy, name, files = shipped
    right = compile_c(files, tmp_path / "right", "check", *options)
    assert subprocess.run([right], capture_output=True, timeout=10, check=False).returncode == 0
    moved = policy.with_parameters(
        np.clip(policy.parameters() * 1.01, policy.layout().lower, policy.layout().upper)
    )
    wrong = compile_c(files | circuit_files(moved, name, "test"), tmp_path / "wrong", "check", *options)
    assert subprocess.run([wrong], capture_output=True, timeout=10, check=False).returncode == 1


def test_the_code_has_no_static_memory_and_needs_only_libm(shipped, tmp_path):
    files = {file: text for file, text in shipped[2].items() if "check" not in file}
    built = compile_c(files, tmp_path, "p.o", "-r", "-nostdlib")
    symbols = subprocess.run(["nm", built], capture_output=True, text=True, timeout=10, check=True).stdout
    kinds = {tuple(line.split()[-2:]) for line in symbols.splitlines()}
    assert {symbol for kind, symbol in kinds if kind in "bBdDC"} == set()
    assert {symbol for kind, symbol in kinds if kind == "U"} <= {"cos", "sin", "sincos", "remainder"}


def test_the_command_writes_its_files_and_names_them(tmp_path, capsys):
    assert run(["export", "course", "--to", "c", "--out", str(tmp_path / "new"), "--json"]) == 0
    fields = json.loads(capsys.readouterr().out)
    assert {Path(path).name for path in fields["files"]} == {
        "course.h",
        "course.c",
        "course_course.h",
        "course_course.c",
        "course_check.c",
    }
    assert all(Path(path).is_file() for path in fields["files"])


def test_yaml_is_a_policy_file_to_edit(tmp_path):
    assert run(["export", "parking", "--to", "yaml", "--out", str(tmp_path)]) == 0
    assert (tmp_path / "parking.yaml").read_text() == policy_to_yaml(load_policy("parking"))


def test_a_file_name_that_is_no_identifier_becomes_one(tmp_path):
    path = tmp_path / "2nd-try.v3.yaml"
    shutil.copy(resolve("policies", "parking"), path)
    assert run(["export", str(path), "--to", "c", "--out", str(tmp_path)]) == 0
    files = {file.name: file.read_text() for file in tmp_path.glob("policy_2nd_try_v3*")}
    compile_c(files, tmp_path / "built", "check")


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
@pytest.mark.parametrize("real", [[], ["-DROVER_NCP_FLOAT"]], ids=["double", "float"])
def test_a_program_in_cpp_links_and_runs(shipped, tmp_path, real):
    _, name, files = shipped
    sources = {file: text for file, text in files.items() if not file.endswith("_check.c")}
    program = f"""#include "{name}_course.h"
int main()
{{
    {name}_state state;
    {name}_course course;
    {name}_real observation[{name.upper()}_INPUTS], command[{name.upper()}_OUTPUTS];
    {name}_reset(&state);
    {name}_course_start(&course);
    {name}_observe(&course, 0, 0, 0, observation);
    const int result = {name}_tick(&state, observation, command);
    {name}_course_advance(&course);
    return result;
}}
"""
    compile_c(sources, tmp_path, "policy.o", "-r", *real)
    (tmp_path / "main.cpp").write_text(program)
    strict = ["-std=c++11", "-Wall", "-Wextra", "-Werror", "-pedantic", *real]
    command = ["g++", *strict, "-o", "program", "main.cpp", "policy.o", "-lm"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    assert subprocess.run([tmp_path / "program"], timeout=10, check=False).returncode == 0
