"""The interface of a driver's link to a bridge: `zenoh_link` implements it, and the stack simulation does."""

from typing import Protocol

from deploy.drive.lease import DriverLease
from deploy.drive.measurements import MeasurementSource
from deploy.drive.sources import Sources
from rover_ncp.core.geometry import Velocity
from rover_ncp.wire.protocol import GateStatus, MotorsReply


class Link(MeasurementSource, Protocol):
    """An open link to one bridge."""

    @property
    def robot(self) -> str:
        """Address of the bridge, for messages."""

    @property
    def where(self) -> str:
        """The namespace as a part of an error message; "" without one."""

    @property
    def bridge_alive(self) -> bool:
        """Whether the bridge shows its liveliness token."""

    @property
    def gate(self) -> GateStatus:
        """The newest gate status."""

    @property
    def sources(self) -> Sources:
        """The publishers of the driver's inputs."""

    @property
    def bumped(self) -> int:
        """How many messages so far reported a pressed bumper."""

    @property
    def lease(self) -> DriverLease:
        """The driver's lease."""

    def authorised(self) -> bool:
        """Return whether the bridge takes commands from this driver."""

    def request_motors(self, name: str, unchecked: bool = False) -> MotorsReply:
        """Request the motors and with them the lease. Raises UnreachableError or SafetyStop.

        ``unchecked`` also asks for a robot that is not known to halt when the bridge dies.
        """

    def release(self) -> None:
        """Stop the rover and release the lease, if this driver holds it; never raises."""

    def command(self, velocity: Velocity) -> int:
        """Send a command, v in m/s and omega in rad/s, and return its sequence number."""

    def publish(self, name: str, data: bytes, wall_ns: int) -> None:
        """Send one of the driver's own messages."""
