"""Clearance before and behind the base: the sonars that count, and how long a range counts."""

import math

import pytest

from bridge.pioneer.odometry import ROBOTS, Odometer
from bridge.pioneer.packets import Sip

AHEAD, ASIDE, BEHIND = [2, 3, 4, 5], [0, 1, 6, 7, 8, 9, 14, 15], [10, 11, 12, 13]
ROBOT = ROBOTS["p3at-sh"]


def everything(range_m=5.0):
    return dict.fromkeys(range(16), range_m)


class Clearance:
    """The clearance ahead and behind in the reports of one base."""

    def __init__(self, robot=ROBOT):
        self._odometer = Odometer(robot)

    def update(self, ranges, now):
        sonar = tuple((number, round(range_m * 1000)) for number, range_m in ranges.items())
        report = self._odometer.update(Sip(sonar=sonar), now)
        return report.clear_ahead_m, report.clear_behind_m


@pytest.mark.parametrize("model", ROBOTS)
def test_four_sonars_count_in_each_direction(model):
    for numbers, place in ((AHEAD, 0), (BEHIND, 1)):
        for number in numbers:
            room = Clearance(ROBOTS[model]).update(everything() | {number: 0.3}, 10.0)
            assert (room[place], room[1 - place]) == (0.3, 5.0)
    for number in ASIDE:
        assert Clearance(ROBOTS[model]).update(everything() | {number: 0.3}, 10.0) == (5.0, 5.0)


def test_ranges_of_several_reports_are_combined():
    clearance = Clearance()
    for k, number in enumerate(AHEAD[:-1]):
        room = clearance.update({number: 1.0 + 0.1 * k}, 10.0 + 0.04 * k)
        assert math.isnan(room[0])  # the last of them has not spoken yet
    assert clearance.update({AHEAD[-1]: 2.0, ASIDE[0]: 0.1}, 10.2)[0] == 1.0
    assert clearance.update({AHEAD[0]: 3.0}, 10.3)[0] == 1.1


def test_silent_sonar_makes_only_its_own_direction_unknown():
    clearance = Clearance()
    clearance.update(everything(), 10.0)
    later = {number: 5.0 for number in range(16) if number != AHEAD[1]}
    assert clearance.update(later, 11.0) == (5.0, 5.0)
    room = clearance.update(later, 11.001)
    assert math.isnan(room[0])
    assert room[1] == 5.0
    assert clearance.update({AHEAD[1]: 4.0}, 11.1) == (4.0, 5.0)


def test_clearance_without_sonars_is_unknown():
    assert all(map(math.isnan, Clearance().update({}, 10.0)))
