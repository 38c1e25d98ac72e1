"""The unit box: points and parameters are the same place, and walls reflect."""

import numpy as np
import pytest
from kit.toy_search import DEFAULTS, INERT, LAYOUT, POLICY, WIDTH

from rover_ncp.course.course import load_course
from sim.learn.evaluator import Evaluator
from sim.learn.search import Batch
from sim.learn.search.unit_box import UnitBox, reflected


def test_box_reaches_every_bound_and_returns_to_its_start():
    box = UnitBox.of(LAYOUT, DEFAULTS)
    corners = box.vectors(np.array([np.zeros(box.size), np.ones(box.size)]))
    assert corners[0] == pytest.approx(LAYOUT.lower, rel=1e-12)
    assert corners[1] == pytest.approx(LAYOUT.upper, rel=1e-12)
    assert ((corners >= LAYOUT.lower) & (corners <= LAYOUT.upper)).all()
    assert box.vectors(box.start[None])[0] == pytest.approx(DEFAULTS, rel=1e-12)


def test_inert_parameters_change_no_miss_and_all_others_do():
    rng = np.random.default_rng(1)
    base = np.clip(DEFAULTS + 0.05 * WIDTH * rng.standard_normal(LAYOUT.size), LAYOUT.lower, LAYOUT.upper)
    moves = np.where(base < LAYOUT.upper - 0.02 * WIDTH, 0.01, -0.01) * WIDTH
    vectors = np.concatenate([base + np.diag(moves), base[None]])
    stream, residuals = Evaluator(POLICY, load_course("parking")).stream(1), []
    for part in np.array_split(vectors, 2):  # a stream has no room for all
        stream.submit(0, Batch(part, np.full(len(part), -np.inf)))
        [(_, scores)] = stream.collect()
        residuals += [*scores.residuals.copy()]
    same = np.array([np.array_equal(row, residuals[-1]) for row in residuals[:-1]])
    assert same.tolist() == INERT.tolist()


def test_walls_reflect():
    points = np.array([-0.25, 0.0, 0.3, 1.0, 1.2, 2.5, -1.5])
    assert reflected(points) == pytest.approx([0.25, 0.0, 0.3, 1.0, 0.8, 0.5, 0.5])
