"""A peer that tries to take over a running drive with what it can subscribe to; it knows no key."""

import json
import os
import struct
import threading
import time

from kit.bridge_bench import client
from rover_ncp.core.geometry import Velocity
from rover_ncp.wire.messages import read_text, twist_stamped

VELOCITY = Velocity(-0.25, 0.5)
"""What it wants; no policy of these tests drives backward."""
TIMEOUT_S = 0.5


class Attacker:
    """Hears all messages and all requests of others. Each attempt is one message or one request."""

    def __init__(self, locator):
        self.session = client(locator)
        self.commands, self.requests, self.gates, self.answers = [], [], [], []
        self._held = [
            self.session.declare_subscriber("**", self._message),
            self.session.declare_queryable("**", self._request),
        ]
        self._attempts = [
            self.copied_tag,
            self.replayed_command,
            self.guessed_sequence,
            self.copied_tag_of_another_age,
            self.release_by_id,
            self.signed_release,
            self.lease_by_id,
            self.signed_renewal,
            self.replayed_request,
            self.guessed_digest,
        ]

    def attempt(self, number):
        """Make one attempt, each kind in turn."""
        self._attempts[number % len(self._attempts)](number)

    def _message(self, sample):
        name, data = str(sample.key_expr), sample.payload.to_bytes()
        if name == "cmd_vel" and sample.attachment is not None:
            self.commands.append((data, sample.attachment.to_bytes()))
        elif name == "rover/gate":
            self.gates.append(json.loads(read_text(data)))

    def _request(self, query):
        if str(query.key_expr) == "rover/motors" and query.payload is not None:
            tag = query.attachment
            request = (query.payload.to_bytes(), None if tag is None else tag.to_bytes())
            if threading.current_thread().name != "MainThread":
                self.requests.append(request)

    def close(self):
        self.session.close()

    def _tag(self, *, ahead=0, late_s=0.0, digest=None):
        """The newest tag heard, with other numbers."""
        lease, sequence, stamp_ns, copied = struct.unpack("<QQq16s", self.commands[-1][1])
        return struct.pack(
            "<QQq16s", lease, sequence + ahead, stamp_ns + round(late_s * 1e9), digest or copied
        )

    def _put(self, payload, tag):
        self.session.put("cmd_vel", payload, attachment=tag)

    def _ask(self, payload, tag=None):
        for reply in self.session.get("rover/motors", payload=payload, attachment=tag, timeout=TIMEOUT_S):
            if reply.ok is not None:
                self.answers.append(json.loads(reply.ok.payload.to_string()))

    def _json(self, enable):
        request = {"version": 2, "enable": enable, "name": "attacker", "sent_ns": time.monotonic_ns()}
        return json.dumps(request).encode()

    # The attempts.

    def copied_tag(self, number):
        self._put(twist_stamped(VELOCITY, time.time_ns()), self._tag())

    def replayed_command(self, number):
        self._put(*self.commands[number % len(self.commands)])

    def guessed_sequence(self, number):
        self._put(twist_stamped(VELOCITY, time.time_ns()), self._tag(ahead=1 + number))

    def copied_tag_of_another_age(self, number):
        self._put(twist_stamped(VELOCITY, time.time_ns()), self._tag(ahead=1000 + number, late_s=0.05))

    def guessed_digest(self, number):
        tag = self._tag(ahead=1, late_s=0.01, digest=os.urandom(16))
        self._put(twist_stamped(VELOCITY, time.time_ns()), tag)

    def release_by_id(self, number):
        self._ask(self._json(enable=False))

    def signed_release(self, number):
        self._ask(self._json(enable=False), self._tag(ahead=1 + number))

    def lease_by_id(self, number):
        self._ask(self._json(enable=True))

    def signed_renewal(self, number):
        self._ask(self._json(enable=True), self._tag(ahead=1 + number))

    def replayed_request(self, number):
        self._ask(*self.requests[0])
