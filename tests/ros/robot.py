"""A robot with differential drive as a ROS 2 node: real rclpy on DDS, or a foreign rmw_zenoh in Python.

It has odometry with covariance, a gyro, a battery, limits of acceleration, a delay, and a timeout of its own.
Each 0.1 s it prints its true state as JSON. It ends with its input.
"""

import argparse
import json
import math
import time
from collections import deque

from wires import WIRES, header, input_open

STEP_S, PRINT_S = 0.01, 0.1
ODOMETRY, IMU, BATTERY = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu", "sensor_msgs/msg/BatteryState"
BOOL = "std_msgs/msg/Bool"


class Body:
    """Where the robot is and how fast it moves; commands act after a delay, and end after ``timeout_s``."""

    def __init__(self, accel, alpha, delay_s, timeout_s):
        self.accel, self.alpha, self.delay_s, self.timeout_s = accel, alpha, delay_s, timeout_s
        self.x = self.y = self.theta = self.v = self.omega = 0.0
        self.wanted, self.fed_s, self.now = (0.0, 0.0), -math.inf, time.monotonic()
        self.queue = deque()

    def command(self, v, omega):
        self.queue.append((time.monotonic() + self.delay_s, v, omega))

    def advance(self, now):
        while self.now + STEP_S <= now:
            self.now += STEP_S
            while self.queue and self.queue[0][0] <= self.now:
                self.fed_s, *self.wanted = self.queue.popleft()
            if self.now - self.fed_s > self.timeout_s:
                self.wanted = (0.0, 0.0)
            v, omega = self.wanted
            self.v += max(-self.accel * STEP_S, min(self.accel * STEP_S, v - self.v))
            self.omega += max(-self.alpha * STEP_S, min(self.alpha * STEP_S, omega - self.omega))
            self.theta += self.omega * STEP_S
            self.x += self.v * math.cos(self.theta) * STEP_S
            self.y += self.v * math.sin(self.theta) * STEP_S

    @property
    def truth(self):
        return {name: getattr(self, name) for name in ("x", "y", "theta", "v", "omega")}


class Robot:
    """The body and its topics."""

    def __init__(self, arguments):
        self.arguments, self.clock_s = arguments, arguments.clock
        self.since_s = time.time() - time.monotonic()
        self.body = Body(arguments.accel, arguments.alpha, 0.08, arguments.timeout)
        self.turned = self.body.theta, self.body.now
        self.wire = WIRES[arguments.by]("robot", arguments.namespace, arguments.router)
        reliable = not arguments.best_effort
        self.publishers = {
            name: self.wire.publisher(topic, ros_type, reliable and name != "imu")
            for name, topic, ros_type in [
                ("odom", arguments.odom, ODOMETRY),
                ("imu", arguments.imu, IMU),
                ("battery", arguments.battery, BATTERY),
            ]
        }
        if arguments.stop:
            self.publishers["stop"] = self.wire.publisher(arguments.stop, BOOL, reliable)
        self.wire.subscribe(arguments.cmd_vel, "geometry_msgs/msg/TwistStamped", self.receive)

    def receive(self, message):
        self.body.command(message.twist.linear.x, message.twist.angular.z)

    def run(self):
        now = time.monotonic()
        due = dict.fromkeys((*self.publishers, "print"), now)
        while input_open():
            self.wire.spin(max(0.0, min(due.values()) - time.monotonic()))
            self.body.advance(now := time.monotonic())
            periods = {
                "odom": 1 / self.arguments.rate,
                "imu": 1 / 20.0,
                "battery": 1.0,
                "stop": 0.1,
            }
            for name in [name for name, at in due.items() if now >= at]:
                # A robot that was held up does not send what it missed.
                period = periods.get(name, PRINT_S)
                due[name] = now + period if now > due[name] + period else due[name] + period
                if name == "print":
                    print(json.dumps(self.body.truth), flush=True)
                else:
                    self.publishers[name](getattr(self, name)())
        self.wire.close()

    def header(self, frame):
        # The moment of the state: what takes long to publish is no newer for it.
        return header(self.body.now + self.since_s + self.clock_s, frame)

    def odom(self):
        body = self.body
        turn = {"z": math.sin(body.theta / 2), "w": math.cos(body.theta / 2)}
        spread = [0.0] * 36
        spread[0], spread[7], spread[14], spread[21], spread[28], spread[35] = 1e-4, 1e-4, 1e6, 1e6, 1e6, 1e-3
        pose = {"position": {"x": body.x, "y": body.y}, "orientation": turn}
        twist = {"linear": {"x": body.v}, "angular": {"z": body.omega}}
        return {
            "header": self.header("odom"),
            "child_frame_id": "base_link",
            "pose": {"pose": pose, "covariance": spread},
            "twist": {"twist": twist, "covariance": spread},
        }

    def imu(self):
        # A gyro measures turns between its messages too: the mean since the last one.
        (theta, now), body = self.turned, self.body
        self.turned = body.theta, body.now
        rate = (body.theta - theta) / (body.now - now) if body.now > now else body.omega
        return {"header": self.header("imu_link"), "angular_velocity": {"z": rate}}

    def stop(self):
        return {"data": False}

    def battery(self):
        return {"header": self.header("base_link"), "voltage": self.arguments.volts, "present": True}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("--by", choices=WIRES, default="rclpy")
    add("--router", default="", help="HOST:PORT of the Zenoh router, for rmw_zenoh")
    add("--namespace", default="")
    add("--odom", default="odom")
    add("--imu", default="imu")
    add("--battery", default="battery_state")
    add("--cmd-vel", default="cmd_vel")
    add("--stop", default="", help="the topic of its stop button, if it has one")
    add("--best-effort", action="store_true")
    add("--rate", type=float, default=20.0)
    add("--clock", type=float, default=0.0, help="its clock minus this machine's, s")
    add("--timeout", type=float, default=0.5)
    add("--accel", type=float, default=0.9)
    add("--alpha", type=float, default=7.7)
    add("--volts", type=float, default=14.4)
    Robot(parser.parse_args()).run()


if __name__ == "__main__":
    main()
