"""Errors of odometry from stands whose truth is known, with both signs of each."""

import math

import numpy as np
import pytest

from deploy.identify.motion_log import MotionLog, Track
from deploy.identify.odometry_fit import Stand, fit_center, fit_turns

RATES = [0.12, 0.12, 0.3, 0.3, 0.5, 0.5]
NOISE_RAD = 0.0005
DT = 0.02


def record(scale, slip, imbalance, asymmetry):
    """Return a log of turns to both sides, straight ways between them, and the stands beside."""
    rng = np.random.default_rng(3)
    times, motions, t, own, true = [], [], 0.0, 0.0, 0.0
    variance = np.array([1e-6, 1e-6, NOISE_RAD**2])

    def stand():
        nonlocal t
        begin, t = t, t + 1.0
        noise = NOISE_RAD * rng.standard_normal(2)
        seen = (np.array([0.0, 0.0, angle + each]) for angle, each in zip((own, true), noise, strict=True))
        return Stand(begin, t, *seen, variance, variance)

    stands = [stand()]
    for rate in RATES:
        for v, omega in ((0.0, rate), (0.2, 0.0), (0.0, -rate), (-0.15, 0.0)):
            for _ in range(round(2.5 / DT)):
                turn = omega * (1.0 - asymmetry * np.sign(omega)) + slip * omega * abs(omega) - imbalance * v
                motions.append((v, scale * turn))
                times.append(t)
                t, own, true = t + DT, own + scale * turn * DT, true + omega * DT
            times.append(t)
            stands.append(stand())
            times.append(t)
            motions += [(0.0, 0.0)] * 2
    poses = np.zeros((len(times), 3))
    track = Track(np.array(times), poses)
    return MotionLog(np.zeros(0), np.zeros((0, 2)), track, np.array(motions), track), stands


@pytest.mark.parametrize("scale", [0.714, 0.87, 1.0])
@pytest.mark.parametrize("asymmetry", [-0.15, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15])
@pytest.mark.parametrize("slip", [0.0, 0.3])
def test_errors_of_a_turn_are_found_to_both_sides(scale, asymmetry, slip):
    fit = fit_turns(*record(scale, slip, -0.02, asymmetry))
    assert fit is not None
    true = [scale, slip, -0.02, 0.0, asymmetry]
    assert (np.abs(fit.values - true) <= 4.0 * np.sqrt(np.diag(fit.covariance)) + 0.002).all()


@pytest.mark.parametrize("slide", [0.6, -0.6, 0.03, -0.03])
def test_a_slide_beyond_what_can_be_is_not_found(slide):
    variance = np.full(3, 1e-6)
    headings = [0.0, 0.5, 1.0, 0.4, -0.2, -0.8, 0.0]
    turned = np.cumsum([0.0, *np.abs(np.diff(headings))])
    stands = [
        Stand(
            t,
            t + 1.0,
            np.array([0.0, 0.0, heading]),
            np.array([slide * way, 0.0, heading]),
            variance,
            variance,
        )
        for t, (heading, way) in enumerate(zip(headings, turned, strict=True))
    ]
    fit = fit_center(stands)
    if abs(slide) > 0.5:
        assert fit is None
    else:
        assert fit.values == pytest.approx([0.0, slide, 0.0], abs=1e-6)
        assert math.isfinite(fit.covariance.sum())
