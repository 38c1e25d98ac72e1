"""The schedule of ticks on virtual time."""

import pytest

from deploy.drive.rate_keeper import RateKeeper
from rover_ncp.core.clock_offset import NS_PER_S

MS = 1_000_000
PERIOD = 100 * MS


def test_schedule_is_absolute_so_lateness_never_adds_up():
    keeper = RateKeeper(PERIOD, 5 * NS_PER_S)
    deadline = 5 * NS_PER_S - 50 * MS
    for tick in range(320):
        assert keeper.due_ns == 5 * NS_PER_S + tick * PERIOD
        assert keeper.opens_ns == deadline  # windows of neighbouring ticks touch and do not overlap
        deadline = keeper.deadline_ns
        keeper.ticked(keeper.due_ns + 7 * MS, predicted=False)
    report = keeper.report()
    assert (report.ticks, report.overruns) == (320, 0)
    assert report.tick_rate_hz == pytest.approx(10.0)
