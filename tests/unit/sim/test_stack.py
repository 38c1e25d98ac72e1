"""Random trials through the whole stack on a virtual clock, and what a base does in a trial."""

import math

import numpy as np
import pytest
from kit.paths import DATA
from scipy.stats import chi2

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.geometry import Pose, Velocity, distance
from rover_ncp.course.course import load_course
from rover_ncp.course.scoring import Parked
from rover_ncp.robot.description import load_description
from rover_ncp.robot.profile import RoverProfile
from sim.base.drive_train import DriveTrain
from sim.base.trial import BaseTrial
from sim.evaluate import trial_runs
from sim.learn import progress
from sim.learn.policies import circuit_driver, load_driver
from sim.learn.progress import train_progress
from sim.learn.rollout import rollout
from sim.stack.estimates import summary
from sim.stack.trials import Stack, drive_all
from sim.world.bodies import Body
from sim.world.described import default_rover, ranges_for
from sim.world.pymunk_rover import Ground, PymunkRover
from sim.world.randomization import Randomization, draw_trials, load_randomization, nominal_trials
from sim.world.skid_robot import Contact, SkidRanges

SHORT, BRIEF, ARC = (str(DATA / f"{name}_course.yaml") for name in ("short", "brief", "arc"))


def stack(ranges="none", seed=1, course=SHORT, body=Body.PYMUNK, **sensors):
    known = ranges if isinstance(ranges, Randomization) else load_randomization(ranges, body)
    return Stack(load_driver("course"), (load_course(course),), known, seed, **sensors)


def drive_plainly(driven, number):
    """Drive a trial of a stack in plain simulation."""
    driver, trials = driven.driver, driven.drawn(number).trials
    return rollout(driver.signals, driven.course(number), trials=trials, runner=driver.runner())


def apart(one, other):
    """Metres between two poses."""
    return distance(Pose(*one), Pose(*other))


@pytest.fixture(scope="module")
def parking():
    """Two trials of randomised robots, which are recorded once for all tests."""
    driven = stack("full", seed=3, course=ARC)
    return driven, drive_all(driven.drive, 2, 1)


def test_trials_park(parking):
    _, found = parking
    for trial in found:
        assert trial.parked
        assert (trial.reason, trial.ticks, trial.overruns) == ("", 80, 0)


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
        # What differs: whole mm/s and deg/s, encoder steps, and an estimate that is less noisy.
        assert apart(plain.poses[-1], trial.pose) < 0.005
        # A driver hides the lateral error of a rover at rest, so that it turns further towards the goal.
        goal, heading = driven.course(number).goal.theta, plain.poses[-1][2]
        assert min(goal, heading) - 0.02 < trial.pose.theta < max(goal, heading) + 0.02


@pytest.mark.parametrize("shown", [trial_runs.progress, train_progress])
def test_long_command_prints_its_progress_into_a_file(capsys, monkeypatch, shown):
    monkeypatch.setattr(progress, "LINE_S", 0.0)
    with shown(2) if shown is trial_runs.progress else shown(2, "agents") as show:
        if shown is train_progress:
            show(2, "best -0.1")
        else:
            show()
            show()
    assert "2 of 2" in capsys.readouterr().err


def test_json_has_each_drive_with_the_drivers_verdict(run_json):
    code, fields = run_json(f"eval course --stack --course {ARC} --randomize full --seed 3 --trials 2")
    driven = drive_all(stack("full", seed=3, course=ARC).drive, 2, 1)
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


def test_a_known_start_reaches_the_driver_through_external_poses():
    driven = stack(Randomization(name="far", start_m=0.1, start_rad=0.1745), seed=5)
    for number in range(2):
        plain = drive_plainly(driven, number)
        assert np.hypot(*driven.drawn(number).trials.start[0, :2]) > 0.05
        assert apart(plain.poses[-1], driven.drive(number).pose) < 0.01


def test_a_driver_that_a_rule_stops_has_not_parked():
    # Odometry that jumps by decimetres, of a robot whose driver believes that it does not.
    driven = stack(Randomization(name="wild", noise_m=0.3))
    driven.__dict__["known"] = RoverProfile(name="calm")
    trial = driven.drive(0)
    assert not trial.parked
    assert trial.reason == "stopped by estimator"
    assert trial.ticks < 20


def test_a_base_lives_through_a_trial_by_counting_its_reports():
    ranges = load_randomization("harsh")
    trials = draw_trials(ranges, default_rover(), 3, count=1, ticks=320)
    base = BaseTrial(trials)
    assert (base.noise, base.lost, base.push) == (Pose(0.0, 0.0, 0.0), False, None)
    lost, pushes = [], []
    for tick in range(400):
        base.tick = tick
        lost.append(base.lost)
        pushes += [(tick, base.push)] if base.push else []
        assert tick >= 320 or base.noise == pytest.approx(tuple(trials.noise[0, tick]))
    assert lost[:320] == trials.lost[0].tolist()
    assert not any(lost[320:])
    assert pushes == [(int(320 * trials.bump[0, 0]), Pose(*trials.bump[0, 1:].tolist()))]
    ages = set()
    for tick in range(320):
        base.tick = tick - 1
        ages.add(round(base.next_age_s / 0.01))
    assert ages == {0, 1, 2, 3, 4, 5}


def test_encoders_see_what_odometry_in_the_simulator_sees():
    trials = draw_trials(load_randomization("harsh"), default_rover(), 3, count=1, ticks=10)
    base, motion = BaseTrial(trials), Velocity(0.12, -0.15)
    seen = base.measured(motion)
    distance_scale, heading_scale = trials.odometry[0]
    turn = motion.omega * (1 + trials.slip[0] * abs(motion.omega)) - trials.wheel_mismatch[0] * seen.v
    assert seen.v == pytest.approx(distance_scale * motion.v)
    assert seen.omega == pytest.approx(heading_scale * turn + trials.drift[0])


def test_stiction_holds_a_base_again_after_its_watchdog_halted_it():
    ranges = Randomization(name="sticks", dead_band_m_s=(0.1, 0.1))
    trials = draw_trials(ranges, default_rover(stiction=0.5), 1, count=1, ticks=1)
    wheels = DriveTrain(
        load_description("p3at-sh"), PymunkRover(default_rover(), Ground()), BaseTrial(trials)
    )

    def speed(v):
        wheels.set_speed(v)
        for _ in range(300):
            wheels.substep(False)
        return wheels.rover.velocity.v

    wheels.enable(True)
    assert speed(0.08) == 0.0
    assert speed(0.15) == pytest.approx(0.15, abs=1e-6)
    assert speed(0.08) == pytest.approx(0.08, abs=1e-6)
    for _ in range(300):
        wheels.substep(True)
    assert speed(0.08) == 0.0


def test_without_a_trial_a_base_is_as_it_should_be():
    base = BaseTrial(nominal_trials(default_rover(), 1))
    assert base.driven(0.123, -0.456, (0.0, 0.0)) == (0.123, -0.456)
    assert base.measured(Velocity(0.123, -0.456)) == (0.123, -0.456)
    assert set(base.efforts.values()) == {1.0}


def test_values_of_a_profile_are_not_drawn():
    profile = RoverProfile(name="mine", delay_v_s=0.21, gain_v=1.1, odometry_distance=1.02, accel=0.248)
    ranges = load_randomization("full").model_copy(update={"rover": profile})
    model = default_rover()
    free = draw_trials(load_randomization("full"), model, 1, count=20, ticks=320)
    tied = draw_trials(ranges, model, 1, count=20, ticks=320)
    assert (tied.delay[:, 0] == 21).all()
    assert (tied.delay[:, 1] == free.delay[:, 1]).all()
    assert tied.acceleration[:, 0] == pytest.approx(0.8)
    assert tied.odometry[:, 0] == pytest.approx(1.02)
    # A gain is what odometry sees of it.
    assert tied.gain[:, 0] * tied.odometry[:, 0] == pytest.approx(1.1)
    for name in ("start", "noise", "lost"):
        assert (getattr(tied, name) == getattr(free, name)).all()


def test_a_profile_makes_exact_trials_inexact_only_where_odometry_errs():
    model, none = default_rover(), load_randomization("none")

    def exact(**stated):
        ranges = none.model_copy(update={"rover": RoverProfile(name="mine", **stated)})
        return draw_trials(ranges, model, 1, count=1, ticks=10).exact

    assert exact(delay_v_s=0.2, gain_omega=0.9)
    assert not exact(odometry_distance=1.01)
    assert not exact(noise_m=0.001)


def test_profile_is_read_from_its_file(tmp_path):
    (tmp_path / "mine.yaml").write_text("name: x\ngain_v: 1.05\n")
    assert ranges_for("full", tmp_path / "mine.yaml").rover.gain_v == 1.05


def test_a_driver_makes_up_for_known_gains():
    slow = RoverProfile(name="slow", gain_v=0.75, gain_omega=0.8)
    ranges = load_randomization("none").model_copy(update={"rover": slow})
    usual, known, unknown = stack(), stack(ranges), stack(ranges)
    unknown.__dict__["known"] = RoverProfile(name="unmeasured")
    # The circuit asks for more, and gets as far as on a robot as it should be.
    there = usual.drive(0).pose
    assert apart(known.drive(0).pose, there) < 0.01 < apart(unknown.drive(0).pose, there)


def test_a_driver_makes_up_for_the_turn_gain_that_its_gyro_or_its_identification_shows():
    # Far outside the training's turn gains of 1.0 to 1.4; without either, both end 0.2 rad off.
    slow, fast = (Randomization(name="turning", turn_gain=(gain, gain)) for gain in (0.7, 1.5))
    ends = [stack(ranges, course=ARC, gyro=True).drive(0) for ranges in (slow, fast)]
    ends.append(stack(fast, course=ARC, identify=True).drive(0))
    assert all(end.parked for end in ends)
    assert all(apart(ends[0].pose, end.pose) < 0.02 for end in ends)


@pytest.mark.parametrize(
    "sensors", [{"gyro": True}, pytest.param({"identify": True}, marks=pytest.mark.long)], ids=str
)
def test_a_skidding_robot_parks_with_a_gyro_or_identified(sensors):
    # By its encoders alone, this robot ends 0.28 m from the goal.
    skid = SkidRanges(mass_center_m=0.06, friction=(0.4, 0.4), contact=Contact(step_s=0.005))
    ranges = Randomization(name="off centre", body=Body.MUJOCO, skid_steer=skid)
    trial = stack(ranges, seed=7, course="parking", **sensors).drive(1)
    assert trial.parked
    assert trial.belief.error_m < 0.02


@pytest.mark.long
def test_a_robot_that_was_identified_on_its_slope_drives_there_by_its_encoders():
    # Gravity turns this one to the left by 0.15 rad per radian, whichever way it turns.
    slope = load_randomization("slope", Body.MUJOCO)
    known = stack(slope, seed=990001, course="parking", identify=True)
    profile = known.identified(18)
    assert profile.turn_asymmetry > 0.05
    assert profile.odometry_heading < 0.8
    assert known.drive(18).belief.error_m < 0.08


@pytest.mark.long
def test_a_known_centre_of_rotation_does_not_move_the_goal():
    # It lies off the middle, so that these robots slide in their last turn, when they cannot correct it.
    slope = load_randomization("slope", Body.MUJOCO)
    known = stack(slope, seed=88003, course="parking", identify=True)
    assert [known.drive(number).parked for number in (8, 16)] == [True, True]


def test_correct_poses_are_believed_where_cables_move_the_rover():
    rough = stack(load_randomization("rough", Body.MUJOCO), seed=777003, course="parking", camera=True)
    trial = rough.drive(9)
    assert not trial.reason.startswith("stopped by")
    assert trial.belief.error_m < 0.01


def test_noise_of_the_estimate_does_not_move_a_rover_at_its_goal():
    # Answers of 1 to 2 mm/s and half a degree a second move this robot by more than parking allows.
    assert stack("full", seed=61201, course="parking").drive(28).reason == ""


def test_the_command_line_drives_another_body(run_json):
    code, fields = run_json(f"eval course --stack --body mujoco --sensors camera --course {BRIEF}")
    assert (code, fields["success_rate"], fields["trials"], fields["stack"]["overruns"]) == (0, 1.0, 1, 0)
    assert (fields["body"], fields["randomize"], fields["course"]) == ("mujoco", "nominal", BRIEF)
    assert math.isfinite(fields["stack"]["times_real_time"])


VARYING = [
    ({}, False),
    ({"gyro": True}, True),
    ({"camera": True}, True),
    ({"robot": load_description("p3dx")}, False),
    ({"robot": load_description("turtlebot4")}, True),
]


@pytest.mark.parametrize(("options", "varies"), VARYING)
def test_nominal_robots_differ_by_the_noise_of_their_sensors_alone(options, varies):
    driven = stack(course=BRIEF, **options)
    first, second = drive_all(driven.drive, 2, 1)
    assert (driven.varies, first.pose != second.pose) == (varies, varies)


CIRCUITS, SPREAD = 5, 0.01
ROOM = 0.9
"""Circuits that use more of a tolerance may miss it by a small difference."""


@pytest.mark.long
def test_circuits_that_park_without_quantisation_park_with_it():
    course, shipped = load_course("parking"), load_policy("parking")
    bounds = course.parked.model_dump(exclude={"still_s"})
    rule = course.parked.model_copy(update={name: ROOM * bound for name, bound in bounds.items()})
    narrow = course.model_copy(update={"parked": rule})
    layout, stream, found = shipped.layout(), np.random.default_rng(5), 0
    while found < CIRCUITS:
        noise = SPREAD * stream.normal(size=layout.size) * (layout.upper - layout.lower)
        vector = np.clip(shipped.parameters() + noise, layout.lower, layout.upper)
        policy = shipped.with_parameters(vector)
        if rollout(policy, narrow).verdict.parked:
            found += 1
            driven = Stack(circuit_driver(policy), (course,), load_randomization("none"), 0).drive(0)
            assert driven.parked, driven
