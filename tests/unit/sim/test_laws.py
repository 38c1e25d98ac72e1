"""The classical laws: as their papers say, and on the trials of the circuits."""

import math

import numpy as np
import pytest

from rover_ncp.course.course import load_course
from rover_ncp.course.signals import REFERENCE_SIGNALS
from sim.learn.engine.evaluator import Evaluator
from sim.learn.engine.laws import KANAYAMA, LAWS, PURE_PURSUIT, SMOOTH, law_command, law_lane_runner
from sim.world.described import default_rover
from sim.world.randomization import draw_trials, load_randomization

COURSE = load_course("parking")


def asked(law, gains, seen):
    return law_command(law, np.array(gains, float), np.array(seen, float))


def test_kanayama_is_his_equation():
    # Kanayama et al. (1990), eq. 8: v = v_r cos θ_e + K_x x_e, ω = ω_r + v_r (K_y y_e + K_θ sin θ_e).
    v, omega = asked(KANAYAMA, (2.0, 10.0, 4.0, 0, 0), (0.05, -0.02, 0.3, 0.1, 0.07))
    assert v == pytest.approx(0.1 * math.cos(0.3) + 2.0 * 0.05)
    assert omega == pytest.approx(0.07 + 0.1 * (10.0 * -0.02 + 4.0 * math.sin(0.3)))


def test_pure_pursuit_drives_the_arc_through_the_point_ahead():
    v, omega = asked(PURE_PURSUIT, (1.0, 0.2, 0.0, 0, 0), (0.03, 0.05, 0.4, 0.1, 0.0))
    x, y = 0.03 + 0.2 * math.cos(0.4), 0.05 + 0.2 * math.sin(0.4)
    radius = v / omega
    assert math.hypot(x, y - radius) == pytest.approx(radius)  # on the circle that touches the rover's axis


@pytest.mark.parametrize("seen", [(0.3, 0.2, 0.5), (0.4, -0.1, -0.9), (0.1, 0.3, 1.2)])
def test_the_smooth_law_leads_into_the_pose(seen):
    # Followed without delay to a fixed pose, distance and both angles of Park and Kuipers (2011) vanish.
    goal = complex(*seen[:2])
    place, heading, dt = 0j, 0.0, 0.01
    for _ in range(6000):
        local = (goal - place) * complex(math.cos(heading), -math.sin(heading))
        if abs(local) < 0.03:
            break
        # ahead = 0 puts the carrot on the goal itself.
        gains = (0.0, 0.0, 1.0, 3.0, 0, 0)
        v, omega = asked(SMOOTH, gains, (local.real, local.imag, seen[2] - heading, 0.1, 0.0))
        v, omega = 0.1, omega * 0.1 / v if v else 0.0
        place += dt * v * complex(math.cos(heading), math.sin(heading))
        heading += dt * omega
    assert abs(goal - place) < 0.03
    assert abs(heading - seen[2]) < 0.15


@pytest.mark.parametrize("law", LAWS)
def test_a_law_stands_still_below_its_thresholds(law):
    trials = draw_trials(load_randomization("none"), default_rover(), 0, count=1, ticks=COURSE.ticks)
    engine = Evaluator(
        REFERENCE_SIGNALS, [COURSE], default_rover(), trials, lane_runner=law_lane_runner(LAWS[law])
    )
    asleep = np.array([*LAWS[law].tuned[:-2], 9.0, 9.0])
    assert engine.outcomes([asleep]).error_m[0, 0] == pytest.approx(math.hypot(*COURSE.goal[:2]))
