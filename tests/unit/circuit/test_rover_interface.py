"""Signals and motions declared in Python: the same numbers everywhere, and errors that say what is wrong."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from paths import DATA

from deploy.drive.controller import Controller
from deploy.estimator.settings import EstimatorSettings
from deploy.report.trace import motor_outputs, motor_shares
from rover_ncp import api
from rover_ncp.circuit import rover_interface
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.geometry import Pose
from sim import api as sim_api
from sim.learn.evaluator import Evaluator

SHORT = str(DATA / "short_course.yaml")


@pytest.fixture(autouse=True)
def declarations(monkeypatch):
    """Declare for one test only."""
    for table in ("_signals", "_motions"):
        monkeypatch.setattr(rover_interface, table, dict(getattr(rover_interface, table)))
    rover_interface._load_extensions.cache_clear()


def with_names(policy, inputs, outputs):
    """Return a policy whose inputs and outputs have other names."""

    def renamed(channels, names):
        return tuple(
            channel.model_copy(update={"name": name}) for channel, name in zip(channels, names, strict=True)
        )

    sensing, motors = policy.sensing, policy.motors
    return replace(
        policy,
        sensing=sensing.model_copy(update={"inputs": inputs, "channels": renamed(sensing.channels, inputs)}),
        motors=motors.model_copy(update={"outputs": outputs, "channels": renamed(motors.channels, outputs)}),
    )


@pytest.fixture
def policy():
    """A policy that senses a built-in signal and three declared ones, and drives by speed and curvature."""

    @api.signal
    def distance(longitudinal: float, lateral: float) -> float:
        return math.hypot(longitudinal, lateral)

    @api.signal
    def bearing(longitudinal: float, lateral: float, heading: float) -> float:
        return math.atan2(lateral, longitudinal + 0.3) + 0.1 * math.sin(heading)

    @api.signal
    def elapsed(start: float) -> float:
        return start

    @api.motion
    def bend(v: float, curvature: float) -> tuple[float, float]:
        return v, (0.2 + v) * curvature

    return with_names(api.load_policy("parking"), ("x", "distance", "bearing", "elapsed"), ("v", "curvature"))


@pytest.mark.long
def test_simulator_lanes_driver_and_controller_agree_to_the_last_bit(policy):
    course = api.load_course(SHORT)
    run = sim_api.rollout(policy, course)
    assert len(np.unique(run.commands[:, 1])) > 10
    [[total]] = Evaluator(policy, course).outcomes(policy.parameters()).total
    assert total == run.total
    driver = api.CourseDriver(policy, course)
    assert np.array_equal([driver.tick(*pose) for pose in run.seen], run.commands)
    controller = Controller(policy, course, EstimatorSettings())
    controller.start(Pose(0.0, 0.0, 0.0), 0.0)
    assert controller.tick(0, 0.0).command == tuple(run.commands[0])


def test_shares_of_motor_neurons_are_in_v_and_omega(policy):
    run = sim_api.rollout(policy, SHORT)
    assert motor_outputs(policy, run.potentials) == pytest.approx(run.commands, abs=1e-12)
    # Without FWD the rover turns by the rest of the motion: both parts of the command depend on it.
    [forward] = [share for neuron, share in motor_shares(policy, run.potentials) if neuron == "FWD"]
    fastest = int(run.commands[:, 0].argmax())
    v, omega = run.commands[fastest]
    assert forward[fastest] == pytest.approx([v, omega - 0.2 * omega / (0.2 + v)])


def test_an_installed_package_declares_when_a_policy_asks(tmp_path, monkeypatch):
    (tmp_path / "lidar_pack.py").write_text(
        "from rover_ncp import api\n\n@api.signal\ndef ahead(longitudinal: float) -> float:\n"
        "    return 2.0 * longitudinal\n"
    )
    info = tmp_path / "lidar_pack-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lidar-pack\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[rover_ncp.extensions]\nlidar = lidar_pack\n")
    monkeypatch.syspath_prepend(tmp_path)
    parking = api.load_policy("parking")
    assert rover_interface.RoverInterface(parking).built_in
    assert "lidar_pack" not in sys.modules
    asks = with_names(parking, ("ahead", "y", "theta", "start"), ("v", "omega"))
    driver = api.CourseDriver(asks, api.load_course(SHORT))
    assert "lidar_pack" in sys.modules
    assert driver._interface.observe(Pose(0, 0, 0), 1.0, (Pose(0.5, 0, 0), Pose(0, 0, 0)))[0] == 1.0


def test_an_unknown_name_is_answered_with_the_known_ones(policy):
    with pytest.raises(ConfigError, match=r"asks for smell; known are x, .*turn, distance, bearing"):
        api.CourseDriver(
            with_names(policy, ("x", "distance", "smell", "elapsed"), ("v", "curvature")),
            api.load_course(SHORT),
        )
    with pytest.raises(ConfigError, match=r"outputs are left, right; expected v, omega or v, curvature"):
        api.CourseDriver(
            with_names(policy, ("x", "y", "theta", "start"), ("left", "right")), api.load_course(SHORT)
        )


def x(y):  # the name of a built-in signal
    return y


@pytest.mark.parametrize(
    ("declare", "function", "words"),
    [
        (api.signal, lambda smell: smell, "'smell' is no built-in signal"),
        (api.signal, lambda: 0.0, "at least one built-in signal"),
        (api.signal, x, "built-in signal of that name"),
        (api.motion, lambda v, omega: (v, omega), "v and omega are built in"),
        (api.motion, lambda: (0.0, 0.0), "at least one output"),
    ],
)
def test_a_declaration_that_cannot_be_is_refused(declare, function, words):
    with pytest.raises(ConfigError, match=words):
        declare(function)


def test_a_name_is_declared_once(policy):
    def bearing(heading):
        return heading

    with pytest.raises(ConfigError, match="is declared so already"):
        api.signal(bearing)


def gives_text(x):
    return "far"


def needs_python(x):
    return eval("x")


@pytest.mark.parametrize(
    ("function", "words"),
    [(gives_text, "must return a float, got str"), (needs_python, "numba cannot compile it")],
)
def test_a_function_that_gives_no_number_is_refused(function, words):
    api.signal(function)
    asks = with_names(api.load_policy("parking"), (function.__name__, "y", "theta", "start"), ("v", "omega"))
    with pytest.raises(ConfigError, match=words):
        api.CourseDriver(asks, api.load_course(SHORT))


def test_an_extension_that_cannot_be_imported_is_named(tmp_path, monkeypatch):
    info = tmp_path / "broken-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[rover_ncp.extensions]\nbroken = no_such_module_here\n")
    monkeypatch.syspath_prepend(tmp_path)
    asks = with_names(api.load_policy("parking"), ("far", "y", "theta", "start"), ("v", "omega"))
    with pytest.raises(ConfigError, match=r"no_such_module_here.*cannot be imported"):
        api.CourseDriver(asks, api.load_course(SHORT))
