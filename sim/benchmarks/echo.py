"""Echo end of a bare ping-pong over Zenoh: sends back each message as soon as it can.

Run as ``python -m sim.benchmarks.echo echo ROBOT --json``; SIGTERM ends it.
"""

import signal
import sys

import zenoh

from deploy.zenoh_client import client_config

PING, PONG = "bench/ping", "bench/pong"


def _echo(robot: str) -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    config, _ = client_config(robot, None)
    with zenoh.open(config) as session:
        pong = session.declare_publisher(PONG, congestion_control=zenoh.CongestionControl.DROP)
        ping = session.declare_subscriber(PING, lambda sample: pong.put(sample.payload))
        print("ready", file=sys.stderr, flush=True)
        signal.sigwait({signal.SIGTERM})
        ping.undeclare()  # type: ignore[no-untyped-call]


if __name__ == "__main__":
    _echo(sys.argv[2])
