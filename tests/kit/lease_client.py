"""A driver's side of the lease, at a bridge on a virtual clock."""

from deploy.drive.lease import DriverLease
from rover_ncp.wire.messages import twist_stamped
from rover_ncp.wire.protocol import MotorsReply, MotorsRequest, Signed, dump_json, parse_json


class LeaseClient:
    """A driver of a bridge with ``now_ns``, ``time_ns``, ``query``, ``command`` and ``sleep``."""

    def __init__(self, bridge):
        self.bridge, self.lease = bridge, DriverLease()

    def tag(self, kind, name, data):
        return self.lease.sign(kind, name, data, self.bridge.now_ns).pack()

    def motors(self, enable=True, name="x", unchecked=False):
        """Request, renew or release the lease."""
        now_ns = self.bridge.now_ns
        data = dump_json(MotorsRequest(enable=enable, name=name, unchecked=unchecked, sent_ns=now_ns))
        tag = self.tag(Signed.MOTORS, "rover/motors", data) if self.lease.number else None
        reply = parse_json(MotorsReply, self.bridge.query("rover/motors", data, tag))
        if reply.granted:
            self.lease.grant(reply)
        elif not enable:
            self.lease.end()
        return reply

    def drive(self, velocity, times=20):
        """Send commands, 0.05 s apart."""
        for _ in range(times):
            data = twist_stamped(velocity, self.bridge.time_ns())
            self.bridge.command(data, self.tag(Signed.COMMAND, "cmd_vel", data))
            self.bridge.sleep(0.05)
