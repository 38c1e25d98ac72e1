"""Soar's own Pioneer driver as a program: connect, drive, turn, read everything, leave. Says what it saw.

Soar 1.5.2 (PyPI, LGPLv3) is a robotics framework for classes; its client was written against real Pioneers.
"""

import json
import math
import sys
import time

from soar.robot.pioneer import PioneerRobot

robot = PioneerRobot(serial_ports=[sys.argv[1]])
robot.simulated = False


def step(seconds):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        time.sleep(0.1)
        robot.on_step(0.1)


robot.on_load()
motors_before = robot.arcos.standard["FLAGS"] & 1
robot.on_start()
robot.fv = 0.2
step(1.5)
robot.fv = 0.0
step(1.2)
straight = robot.pose
robot.rv = math.radians(30)
step(1.0)
robot.rv = 0.0
step(1.0)
moved = robot.pose
robot.on_stop()
time.sleep(0.3)
arcos = robot.arcos
seen = {
    "config": arcos.config,
    "battery_dv": arcos.standard["BATTERY"],
    "motors_before": motors_before,
    "motors_after": arcos.standard["FLAGS"] & 1,
    "straight": list(straight),
    "turned": moved[2],
    "analogs": len(arcos.io["ANALOGS"]),
    "sonars": robot.sonars,
}
robot.on_shutdown()
print("SEEN " + json.dumps(seen))
