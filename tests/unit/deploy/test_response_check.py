import pytest

from deploy.drive.controller import Controller
from deploy.drive.safety_monitor import ResponseCheck
from deploy.estimator.settings import EstimatorSettings
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.course.course import load_course
from sim.world.described import default_rover
from sim.world.pymunk_rover import Ground, PymunkRover

STILL = Velocity(0.0, 0.0)


def first_complaint(asked, driven, ticks=100):
    """The tick of the first complaint, None if there is none; both are functions of the tick."""
    watch = ResponseCheck()
    return next((k for k in range(ticks) if watch.tick(asked(k), driven(k))), None)


@pytest.mark.parametrize(
    "asked", [Velocity(0.06, 0), Velocity(-0.16, 0), Velocity(0, 0.12), Velocity(0, -0.18)]
)
def test_commands_that_the_rover_does_not_follow_are_noticed_within_two_seconds(asked):
    assert first_complaint(lambda k: asked, lambda k: STILL) == 17
    # Frozen in the middle of a drive.
    assert 25 <= first_complaint(lambda k: asked, lambda k: asked if k < 20 else STILL) <= 40


@pytest.mark.parametrize("asked", [Velocity(0.04, 0), Velocity(0, 0.09), STILL])
def test_commands_below_the_resolution_are_not_judged(asked):
    assert first_complaint(lambda k: asked, lambda k: STILL) is None


@pytest.mark.parametrize("seconds", [1, 3])
def test_a_turn_to_and_fro_that_cancels_out_is_not_judged(seconds):
    def asked(k):
        return Velocity(0.0, 0.18 if (k // (10 * seconds)) % 2 else -0.18)

    assert first_complaint(asked, lambda k: asked(k - 5) if k > 5 else STILL) is None


@pytest.mark.parametrize("lag", [1, 2, 4, 7])
@pytest.mark.parametrize("ticks", [3, 6, 9])
def test_a_burst_of_commands_is_not_judged_when_it_is_long_over(lag, ticks):
    # As a circuit does that turns the last few degrees on the spot and then stands.
    def asked(k):
        return Velocity(0.0, -0.36) if 20 <= k < 20 + ticks else STILL

    assert first_complaint(asked, lambda k: asked(k - lag)) is None


@pytest.mark.parametrize(
    "model",
    [
        default_rover(),
        default_rover(accel=0.21, delay_v_s=0.3, delay_omega_s=0.3),
    ],
)
def test_a_rover_that_follows_is_never_stopped(model, request):
    """A whole manoeuvre, on the base as it is and on a sluggish one (delays 300 ms, acceleration −30 %)."""
    course, rover = load_course("parking"), PymunkRover(model, Ground())
    for policy in ("parking", str(request.config.rootpath / "tests/data/golden/parking.bnn")):
        controller, watch = Controller(load_policy(policy), course, EstimatorSettings()), ResponseCheck()
        controller.start(Pose(0, 0, 0), -0.1)
        rover.set_pose(Pose(0, 0, 0))
        for index in range(course.ticks):
            controller.estimator.odometry(rover.pose, rover.velocity, 0.1 * index)
            tick = controller.tick(index, 0.1 * index)
            assert watch.tick(tick.command, tick.estimate.velocity) == ""
            rover.command(*tick.command)
            for _ in range(10):
                rover.substep()
