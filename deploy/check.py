"""Pre-flight check of a robot, on blocks or on a free floor: links, sensors, motion, stop without commands.

Each step returns whether it passed, and its finding: what was measured, and what would be right. The first
that fails ends the list: later ones would fail for the same cause. `deploy.comparisons` judges the sensors.
"""

import time
from collections.abc import Callable

from pydantic import BaseModel, Field

from deploy import comparisons
from deploy.check_inputs import NO_REPLY, Battery, InputSteps
from deploy.check_moves import MOVE_S, Moves
from deploy.comparisons import Answer, Samples
from deploy.drive.measurements import Measurements
from deploy.drive.safety_monitor import SafetyMonitor
from deploy.drive.zenoh_link import ZenohLink
from deploy.identify.excitation import RAMP, RAMP_STEPS, Ramps, follows
from deploy.publishers import INPUTS, Publishers
from deploy.zenoh_client import BridgeAddress
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.errors import RoverNcpError, SafetyStop
from rover_ncp.core.geometry import Velocity, relative
from rover_ncp.core.process import Clock, Interrupts
from rover_ncp.robot.dead_zone import STEP, DeadZone, clear_of
from rover_ncp.robot.description import RobotDescription
from rover_ncp.wire.protocol import BaseReply, GateStatus, TimeoutState

V_M_S, OMEGA_RAD_S = 0.1, 0.2
"""Slow, and still well above the noise of wheels in the air. A turn is faster if the dead band is large."""
STOP_S = 0.5
"""The first safety requirement; braking and the time to the next report come on top."""
BRAKING_S, REPORT_S = 0.15 + V_M_S / 0.3, 0.1
FAST = 1.6
"""How many times as far as commanded a straight motion may seem by the pose."""
SCALE = 0.15
"""How far the distance by the pose and the distance by the speed may differ, as a share."""
STANDING = 0.01
MAX_BAND = Velocity(0.05, 0.26)
"""Largest dead bands of simulated robots that parked in 9 of 10 trials; with 0.06 and 0.28 it was 6 of 10."""
UNKNOWN_BAND = Velocity(0.02, 0.06)
"""Dead band that a driver need not know, with the resolution of the measurement."""


class Finding(BaseModel):
    """Result of one check."""

    name: str = Field(description="of the check")
    ok: bool = Field(description="whether it passed")
    detail: str = Field(description="in words")


class CheckResult(BaseModel):
    """Result of all checks."""

    ready: bool = Field(description="whether all checks passed")
    findings: list[Finding] = Field(description="the result of each check")
    robot: str = Field(description="the bridge's Zenoh address")


def run(
    address: BridgeAddress, robot: RobotDescription | None = None, *, on_floor: bool = False
) -> CheckResult:
    """Check a robot, against its description if there is one. Raises NoBridge, NotAuthorised."""
    battery = Battery()
    with Interrupts() as interrupts, ZenohLink(address, battery.record) as link:
        measurements = Measurements(link, pose_frame=None)
        monitor = SafetyMonitor(link, measurements, lambda: interrupts.raised)
        monitor.wait_for_bridge()
        publishers = Publishers()
        link.listen(INPUTS, publishers.note)
        preflight = Preflight(
            link, measurements, monitor, battery, publishers, robot=robot, on_floor=on_floor
        )
        findings = preflight.run()
        ready = all(finding.ok for finding in findings)
        return CheckResult(ready=ready, findings=findings, robot=link.robot)


class Preflight:
    """Checks one robot. At every end, the lease is released."""

    def __init__(
        self,
        link: ZenohLink,
        measurements: Measurements,
        monitor: SafetyMonitor,
        battery: Battery,
        publishers: Publishers | None = None,
        *,
        robot: RobotDescription | None = None,
        on_floor: bool = False,
        clock: Clock = time,
    ) -> None:
        self._link, self._measurements, self._robot = link, measurements, robot
        self._clock, self._on_floor = clock, on_floor
        self._moves = Moves(link, measurements, monitor, clock, name="check")
        self._inputs = InputSteps(
            *(link, measurements, monitor, self._moves, battery),
            publishers=publishers or Publishers(),
            robot=robot,
            clock=clock,
        )
        self._straight = self._turn = Samples()
        self._rooms: list[BaseReply | None] = []
        self._follows = Velocity(0.0, 0.0)
        """Least speeds that the base follows, as they were measured."""
        skid = robot is None or robot.drive.kind == "skid"
        self._turn_shares = comparisons.SKID_TURN_SHARES if skid else comparisons.TURN_SHARES

    def run(self) -> list[Finding]:
        """Run all checks, in this order. Raises KeyboardInterrupt after a termination signal."""
        findings: list[Finding] = []
        checks: dict[str, Callable[[], Answer | None]] = {
            "model": self._check_model,
            "link": self._inputs.link,
            "odometry": self._inputs.odometry,
            "clock": self._inputs.clock,
            "inputs": self._inputs.unheard,
            "gyro": self._inputs.gyro,
            "pose": self._inputs.poses,
            "battery": self._inputs.battery,
            "stop": self._inputs.holds,
            "watchdog": self._check_watchdog,
            "motors": self._check_motors,
            "forward": self._check_forward,
            "room": self._check_room,
            "pose-way": self._check_poses_on_way,
            "slow": self._check_slow,
            "left": self._check_left,
            "gyro-turn": self._check_gyro_in_turn,
            "pose-turn": self._check_poses_in_turn,
            "silence": self._check_silence,
        }
        try:
            for name, check in checks.items():
                gate = self._link.gate
                try:
                    answer = check()
                except SafetyStop as stop:  # the gate accepts no more commands
                    answer = False, f"{stop}: {self._gate_since(gate)}"
                if answer is None:
                    continue
                ok, detail = answer
                findings.append(Finding(name=name, ok=ok, detail=detail))
                if not ok:
                    break
        finally:
            self._link.release()
        return findings

    def _check_model(self) -> Answer | None:
        if self._robot is None:
            return None
        base = self._link.about_base()
        found = base.model if base else "a robot without a name"
        return found == self._robot.name, f"the bridge drives {found}, expected {self._robot.name}"

    def _check_gyro_in_turn(self) -> Answer | None:
        if not self._inputs.rest.gyro:
            return None
        turn, shares = self._turn, self._turn_shares
        return comparisons.gyro_in_turn(self._inputs.rest, turn, shares, on_floor=self._on_floor)

    def _check_poses_on_way(self) -> Answer | None:
        if not self._inputs.rest.poses:
            return None
        return comparisons.poses_on_way(self._straight, on_floor=self._on_floor)

    def _check_poses_in_turn(self) -> Answer | None:
        if not self._inputs.rest.poses:
            return None
        return comparisons.poses_in_turn(self._turn, self._turn_shares, on_floor=self._on_floor)

    def _check_room(self) -> Answer | None:
        """Compare what a laser shows ahead and behind with the straight way."""
        laser = self._robot is not None and self._robot.topics is not None and self._robot.topics.scan
        before, after = self._rooms
        if not laser or before is None or after is None:
            return None
        odometry = self._straight.odometry
        driven_m = relative(odometry[0][1], odometry[-1][1]).x
        return comparisons.room_on_way(before.room_m, after.room_m, driven_m, on_floor=self._on_floor)

    def _check_motors(self) -> Answer:
        try:
            began = self._clock.monotonic()
            self._link.request_motors("check")
        except RoverNcpError as error:
            return False, str(error)
        return True, f"granted within {self._clock.monotonic() - began:.3f} s"

    def _check_forward(self) -> Answer:
        gate = self._link.gate
        self._rooms = [self._link.about_base()]
        before, after, by_speed, self._straight = self._moves.move(Velocity(V_M_S, 0.0))
        gate_did = self._gate_since(gate)
        self._moves.rest()
        self._rooms.append(self._link.about_base())
        ahead = relative(before.pose, after.pose).x
        if not follows(after.velocity.v, V_M_S) or ahead <= 0.0:
            moved = f"commanded {V_M_S} m/s, the base reports {after.velocity.v:.3g} m/s and {ahead:.3g} m"
            return False, f"{moved}: {gate_did}"
        words = f"{ahead:.3g} m by its pose, {by_speed.v:.3g} m by its speed"
        if problem := comparisons.jump(self._straight, Velocity(V_M_S, 0.0)):
            return False, problem
        most = FAST * V_M_S * MOVE_S
        if ahead > most:
            return False, f"{words}, at most {most:.3g} m was commanded: has odometry another unit or scale?"
        if self._speed_mean_s:
            return True, f"{words}, which is a mean over {self._speed_mean_s:g} s"
        return abs(ahead - by_speed.v) <= SCALE * by_speed.v, f"{words} (right: ±{SCALE:.0%})"

    def _check_left(self) -> Answer:
        gate, band = self._link.gate, clear_of(self._follows.omega, STEP.omega)
        omega = max(OMEGA_RAD_S, band)
        before, after, by_speed, self._turn = self._moves.move(Velocity(0.0, omega))
        gate_did = self._gate_since(gate)
        self._moves.rest()
        turned = relative(before.pose, after.pose).theta
        reported = f"{after.velocity.omega:.3g} rad/s and {turned:.3g} rad"
        words = f"commanded {omega:.2g} rad/s, the base reports {reported}"
        if not follows(after.velocity.omega, omega) or turned <= 0.0:
            return False, f"{words}: {gate_did}"
        if problem := comparisons.jump(self._turn, Velocity(0.0, omega)):
            return False, problem
        low, high = comparisons.SKID_TURN_SHARES
        if turned > high * omega * MOVE_S:
            return False, f"{words} in {MOVE_S:g} s: has odometry another unit or scale?"
        if not self._speed_mean_s and not low <= turned / by_speed.omega <= high:
            return (
                False,
                f"{words}, but {by_speed.omega:.3g} rad by its turn rates: one of them has another unit",
            )
        return True, words

    def _check_slow(self) -> Answer:
        """Measure the dead band; a driver must know a large one."""
        gate, ramps = self._link.gate, Ramps(self._measurements)
        for step in ramps:
            self._moves.command(step.velocity, step.seconds)
        v, omega = ramps.followed
        if v is None or omega is None:
            most = f"{RAMP_STEPS * RAMP.v:.3g} m/s" if v is None else f"{RAMP_STEPS * RAMP.omega:.3g} rad/s"
            return False, f"follows no slow command up to {most}: {self._gate_since(gate)}"
        self._follows = found = Velocity(v, omega)
        words = f"follows commands from {found[0]:.3g} m/s and {found[1]:.3g} rad/s on"
        if found[0] > 1.01 * MAX_BAND.v or found[1] > 1.01 * MAX_BAND.omega:  # steps have rounding errors
            most = f"{MAX_BAND.v:g} m/s and {MAX_BAND.omega:g} rad/s"
            why = "a policy cannot park with this dead band"
            return False, f"{words}, expected from {most} on at most: {why}, or {self._gate_since(gate)}"
        known = DeadZone(described=self._robot).band
        if found[0] <= known.v + UNKNOWN_BAND.v and found[1] <= known.omega + UNKNOWN_BAND.omega:
            return True, words
        line = f"motion.dead_band: {{v: {found[0]:.3g}, omega: {found[1]:.3g}}}"
        return False, f"{words}, the driver does not know of it; for the robot's description: {line}"

    def _check_silence(self) -> tuple[bool, str]:
        """Test the stop when no more commands arrive, with a robot that moves."""
        gate = self._link.gate
        newest = self._moves.move(Velocity(V_M_S, 0.0)).after
        if not follows(newest.velocity.v, V_M_S):
            moved = f"commanded {V_M_S} m/s, the base reports {newest.velocity.v:.3g} m/s"
            return False, f"not tested: {moved}: {self._gate_since(gate)}"
        silent = self._clock.monotonic()
        braking_s = BRAKING_S
        if self._robot is not None:
            braking_s = max(braking_s, self._robot.delays.v_s + V_M_S / self._robot.motion.decel)
        allowed = STOP_S + braking_s + REPORT_S
        stands = self._moves.until(self._stands, 2 * allowed + self._speed_mean_s)
        # A stall of this process does not count, and mean speeds end later than the motion.
        took = self._moves.newest.ref.measured_ns / NS_PER_S - silent - self._speed_mean_s
        words = f"stands {took:.2f} s after the last command" if stands else "does not stop"
        return stands and took <= allowed, f"{words} (at most {allowed:.2f} s)"

    def _check_watchdog(self) -> Answer:
        """Report when the base halts if the bridge dies, and how that is known."""
        base = self._link.about_base()
        if base is None:
            return False, NO_REPLY
        after = "if the bridge dies, the base halts {} s after its last command"
        match base.state, base.timeout_s:
            case TimeoutState.PUBLISHED, float(seconds):
                return True, f"{after.format(f'{seconds:g}')}, as it reports itself"
            case TimeoutState.MEASURED, float(seconds):
                return True, f"{after.format(f'{seconds:g}')}, as it was measured"
            case _, float(seconds):
                factory = f"the factory setting is {seconds:g} s"
                return True, f"not known: the base does not report its watchdog; {factory}"
        return True, (
            "not known whether the base halts if the bridge dies; measure it with "
            "'rover-ncp bridge --measure-timeout'"
        )

    def _gate_since(self, before: GateStatus) -> str:
        """Return a text on what the gate did to commands since ``before``, with its reasons."""
        gate = self._link.gate
        words = []
        if reason := gate.held or gate.ended:
            detail = f" ({gate.ended_detail})" if gate.ended_detail else ""
            words.append(f"the gate stopped the robot: {reason}{detail}")
        for what, old, new in (
            ("stopped the robot for a moment", before.stops, gate.stops),
            ("dropped commands", before.dropped, gate.dropped),
            ("limited commands", before.limited, gate.limited),
        ):
            grown = [name for name, count in new.items() if count > old.get(name, 0) and name != reason]
            if grown:
                words.append(f"the gate {what}: {', '.join(grown)}")
        return "; ".join(words) or "the gate passed all commands on, look at the base's motors and encoders"

    @property
    def _speed_mean_s(self) -> float:
        return 0.0 if self._robot is None else self._robot.odometry.speed_mean_s

    def _stands(self) -> bool:
        v, omega = self._moves.newest.sample.velocity
        return abs(v) < STANDING and abs(omega) < STANDING
