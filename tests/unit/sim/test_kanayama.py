"""The classical law: as its paper says, and on the trials of the circuits."""

import math

import numpy as np
import pytest

from rover_ncp.course.course import load_course
from rover_ncp.course.signals import REFERENCE_SIGNALS
from sim.learn.engine.evaluator import Evaluator
from sim.learn.engine.kanayama import TUNED, law_command, law_lane_runner
from sim.world.described import default_rover
from sim.world.randomization import draw_trials, load_randomization

COURSE = load_course("parking")


def test_kanayama_is_his_equation():
    # Kanayama et al. (1990), eq. 8: v = v_r cos θ_e + K_x x_e, ω = ω_r + v_r (K_y y_e + K_θ sin θ_e).
    v, omega = law_command(np.array([2.0, 10.0, 4.0, 0.0, 0.0]), np.array([0.05, -0.02, 0.3, 0.1, 0.07]))
    assert v == pytest.approx(0.1 * math.cos(0.3) + 2.0 * 0.05)
    assert omega == pytest.approx(0.07 + 0.1 * (10.0 * -0.02 + 4.0 * math.sin(0.3)))


def test_the_law_stands_still_below_its_thresholds():
    trials = draw_trials(load_randomization("none"), default_rover(), 0, count=1, ticks=COURSE.ticks)
    engine = Evaluator(REFERENCE_SIGNALS, [COURSE], default_rover(), trials, lane_runner=law_lane_runner())
    asleep = np.array([*TUNED[:-2], 9.0, 9.0])
    assert engine.outcomes([asleep]).error_m[0, 0] == pytest.approx(math.hypot(*COURSE.goal[:2]))
