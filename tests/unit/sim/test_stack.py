"""Random trials through the whole stack on a virtual clock, and what a base does in a trial."""

import math

import pytest
from kit.paths import DATA
from scipy.stats import chi2

from rover_ncp.core.geometry import Pose, distance
from rover_ncp.course.course import load_course
from rover_ncp.course.scoring import Parked
from rover_ncp.robot.profile import RoverProfile
from sim.learn.policies import any_policy
from sim.learn.rollout import rollout
from sim.stack.estimates import summary
from sim.stack.trials import Stack, drive_all
from sim.world.bodies import Body
from sim.world.localiser_errors import LocaliserRanges
from sim.world.randomization import Randomization, load_randomization
from sim.world.skid_robot import Contact, SkidRanges

SHORT, BRIEF, ARC = (str(DATA / f"{name}_course.yaml") for name in ("short", "brief", "arc"))


def stack(ranges="none", seed=1, course=SHORT, body=Body.PYMUNK, **sensors):
    known = ranges if isinstance(ranges, Randomization) else load_randomization(ranges, body)
    return Stack(any_policy("course"), (load_course(course),), known, seed, **sensors)


def drive_plainly(driven, number):
    """Drive a trial of a stack in plain simulation."""
    policy, trials = driven.policy, driven.drawn(number).trials
    return rollout(policy.signals, driven.course(number), trials=trials, runner=policy.runner())


def apart(one, other):
    """Metres between two poses."""
    return distance(Pose(*one), Pose(*other))


@pytest.fixture(scope="module")
def parking():
    """Two trials of randomised robots, which are recorded once for all tests."""
    driven = stack("full", seed=3, course=ARC)
    return driven, drive_all(driven.drive, 2, 1)


def test_driver_that_knows_the_dead_band_parks_and_another_does_not():
    ranges = load_randomization("none").model_copy(
        update={"dead_band_m_s": (0.05, 0.05), "dead_band_rad_s": (0.3, 0.3)}
    )
    band = RoverProfile(name="band", dead_band_v=0.05, dead_band_omega=0.3)
    assert not stack(ranges, course=ARC).drive(0).parked
    assert stack(ranges.model_copy(update={"rover": band}), course=ARC).drive(0).parked


def test_drivers_beliefs_are_compared_with_the_truth(parking):
    _, found = parking
    for trial in found:
        assert trial.belief.verdict is Parked.UNCERTAIN  # encoders alone
        assert trial.belief.error_m < 0.02
        assert trial.belief.squared < chi2.ppf(0.999, 2)
    fields = summary([trial.belief for trial in found], [True, False])
    assert (fields.verdict_agrees, fields.quiet_misses) == (None, None)
    assert fields.verdicts == {"parked, uncertain": 2}
    sure, wrong = (trial.belief._replace(verdict=Parked.YES) for trial in found)
    quiet = summary([sure, wrong], [True, False])
    assert (quiet.verdict_agrees, quiet.quiet_misses) == (0.5, 0.5)
    assert quiet.verdicts == {"parked": 2}
    assert fields.error_m.p95 <= max(trial.belief.error_m for trial in found)


def test_the_stack_drives_the_trials_of_plain_simulation(parking):
    driven, found = parking
    for number, trial in enumerate(found):
        plain = drive_plainly(driven, number)
        assert plain.verdict.parked
        assert (trial.parked, trial.reason, trial.ticks, trial.overruns) == (True, "", 80, 0)
        # What differs: whole mm/s and deg/s, encoder steps, and an estimate that is less noisy.
        assert apart(plain.poses[-1], trial.pose) < 0.005
        # A driver hides the lateral error of a rover at rest, so that it turns further towards the goal.
        goal, heading = driven.course(number).goal.theta, plain.poses[-1][2]
        assert min(goal, heading) - 0.02 < trial.pose.theta < max(goal, heading) + 0.02


def test_json_has_each_drive_with_the_drivers_verdict(parking, run_json):
    code, fields = run_json(f"eval course --stack --course {ARC} --randomize full --seed 3 --trials 2")
    _, driven = parking
    assert code == 0
    for number, (drive, trial) in enumerate(zip(fields["drives"], driven, strict=True)):
        assert (drive["trial"], drive["parked"], drive["error_m"]) == (number, trial.parked, trial.error_m)
        assert (drive["verdict"], drive["probability"]) == (trial.belief.verdict, trial.belief.probability)
        assert 0.0 < drive["probability"] < 0.95
    assert fields["stack"]["estimate"]["verdicts"] == {"parked, uncertain": 2}
    assert fields["stack"]["estimate"]["verdict_agrees"] is None


@pytest.mark.long
def test_a_trial_is_the_same_whatever_the_number_of_processes():
    alone = drive_all(stack("harsh").drive, 4, 1)
    assert drive_all(stack("harsh").drive, 4, 2) == alone
    assert stack("harsh").drive(3) == alone[3]
    assert len({trial.pose for trial in alone}) == 4


def test_a_driver_makes_up_for_the_turn_gain_that_its_gyro_or_its_identification_shows():
    # Outside the training's turn gains of 1.0 to 1.4; without either, both end 0.2 rad off.
    fast = Randomization(name="turning", turn_gain=(1.5, 1.5))
    one, other = (stack(fast, course=ARC, **by).drive(0) for by in ({"gyro": True}, {"identify": True}))
    assert one.parked
    assert other.parked
    assert apart(one.pose, other.pose) < 0.02


def test_a_skidding_robot_parks_with_a_gyro():
    # By its encoders alone, this robot ends 0.28 m from the goal.
    skid = SkidRanges(mass_center_m=0.06, friction=(0.4, 0.4), contact=Contact(step_s=0.005))
    ranges = Randomization(name="off centre", body=Body.MUJOCO, skid_steer=skid)
    trial = stack(ranges, seed=7, course="parking", gyro=True).drive(1)
    assert trial.parked
    assert trial.belief.error_m < 0.02


def test_the_command_line_drives_another_body(run_json):
    code, fields = run_json(f"eval course --stack --body mujoco --sensors camera --course {BRIEF}")
    assert (code, fields["success_rate"], fields["trials"], fields["stack"]["overruns"]) == (0, 1.0, 1, 0)
    assert (fields["body"], fields["randomize"], fields["course"]) == ("mujoco", "nominal", BRIEF)
    assert math.isfinite(fields["stack"]["times_real_time"])


def test_localiser_without_errors_that_last_drives_the_same_trial():
    ranges = load_randomization("full")
    same = ranges.model_copy(update={"localiser": LocaliserRanges()})
    biased = ranges.model_copy(update={"localiser": LocaliserRanges(lasting_m=(0.03, 0.03))})
    before, after, wrong = (stack(each, camera=True).drive(0) for each in (ranges, same, biased))
    assert before == after
    assert wrong.belief.error_m > before.belief.error_m
