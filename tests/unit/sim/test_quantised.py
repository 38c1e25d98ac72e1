"""Circuits that park with exact commands also park with whole mm/s and deg/s, encoder steps, an estimate."""

import numpy as np

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.course.course import load_course
from sim.learn.rollout import rollout
from sim.stack.trials import Stack
from sim.world.randomization import load_randomization

CIRCUITS, SPREAD = 5, 0.01
ROOM = 0.9
"""Those that use more of a tolerance may miss it by anything that differs."""
STILL_S = 2.0


def parks_with_room(policy, course):
    driven = rollout(policy, course)
    last, before = (np.array(driven.poses[k]) for k in (-1, -1 - round(STILL_S / 0.1)))
    moved = abs(last - before)
    allowed = course.parked
    return (
        driven.verdict.parked
        and driven.verdict.error_m <= ROOM * allowed.position_m
        and driven.verdict.error_rad <= ROOM * allowed.heading_rad
        and np.hypot(*moved[:2]) <= ROOM * allowed.still_m
        and moved[2] <= ROOM * allowed.still_rad
    )


def test_circuits_that_park_without_quantisation_park_with_it():
    course, shipped = load_course("parking"), load_policy("parking")
    layout, stream, found = shipped.layout(), np.random.default_rng(5), 0
    while found < CIRCUITS:
        noise = SPREAD * stream.normal(size=layout.size) * (layout.upper - layout.lower)
        vector = np.clip(shipped.parameters() + noise, layout.lower, layout.upper)
        policy = shipped.with_parameters(vector)
        if parks_with_room(policy, course):
            found += 1
            driven = Stack(policy, (course,), load_randomization("none"), 0).drive(0)
            assert driven.parked, driven
