"""The benchmarks at a size that takes seconds: what they count must be what happened."""

from benchmarks import deploy as bench_deploy
from deploy.drive.measurements import SampleRef


def test_a_command_is_timed_from_its_own_odometry_sample_also_when_later_ones_were_sent():
    ms = 1_000_000
    record = {"now_ns": 0, "wall_ns": 0, "predicted": False, "estimate": (0.0,) * 5, "command": (0.0, 0.0)}
    refs = [SampleRef(stamp_ns=stamp, crc=0, measured_ns=0, topic="odom") for stamp in (1, 2)]
    ticks = [
        bench_deploy.TickRecord(index=0, samples=tuple(refs), sequence=7, **record),
        bench_deploy.TickRecord(index=1, samples=(), sequence=8, **record),
    ]
    sent = {1: 0, 2: 100 * ms, 3: 200 * ms}
    assert bench_deploy.delays_ms(ticks, sent, {7: 250 * ms, 8: 260 * ms}) == [150.0]
