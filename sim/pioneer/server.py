"""The mock's TCP server: one client at a time on TCP, in real time, and the true pose into a file.

One thread: it sleeps until bytes arrive or the next SIP is due, then advances the firmware to the present.
"""

import errno
import selectors
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from io import FileIO
from pathlib import Path

from rover_ncp.core.errors import PortInUse, UsageError
from rover_ncp.core.files import create
from sim.pioneer.faults import parse_fault
from sim.pioneer.firmware import Firmware
from sim.pioneer.lateness import Lateness
from sim.world.rover import SUBSTEP_S

PERIOD_S = SUBSTEP_S
"""The mock sleeps no longer than a step, so a turn that ends later shows how long it had no CPU."""

CHUNK_BYTES = 4096

BACKLOG_BYTES = 1 << 16
"""A client that does not read loses what is beyond this, as on a serial line."""

TRUTH_COLUMNS = ("t_ns", "t_s", "x", "y", "theta", "v", "omega", "contact", "clock_ns")
"""Wall clock in ns, time since the start in s, true pose in m and rad, speeds in m/s and rad/s, 0 or 1,
simulation clock in ns: the end of the step on the machine's monotonic clock, whenever it was computed."""


def clock_ns(now: float) -> int:
    """Return a moment of the simulation clock in ns."""
    return round(now * 1e9)


def parse_listen(text: str) -> tuple[str, int]:
    """Read ``HOST:PORT``; port 0 takes a free one. Raises UsageError."""
    host, colon, port = text.rpartition(":")
    if not colon or not host or not port.isdigit() or int(port) > 65535:
        raise UsageError(f"--listen {text}: expected HOST:PORT, for example 127.0.0.1:8101")
    return host.removeprefix("[").removesuffix("]"), int(port)


class TruthFile:
    """The true pose as CSV, 100 lines a second, flushed as they come: a kill leaves whole lines behind."""

    def __init__(self, path: Path, *, overwrite: bool = False) -> None:
        """Raise FileError for a path where a file exists, unless ``overwrite``, or where none can be made."""
        self._file = create(path, overwrite=overwrite)
        self._lines = [",".join(TRUTH_COLUMNS)]
        self.flush()

    def add(self, firmware: Firmware, t_ns: int, t_s: float) -> None:
        """Note where the rover is at the end of a step."""
        rover = firmware.drive.rover
        (x, y, theta), (v, omega) = rover.pose, rover.velocity
        self._lines.append(
            f"{t_ns},{t_s:.2f},{x:.6f},{y:.6f},{theta:.6f},{v:.5f},{omega:.5f},{int(rover.in_contact)},"
            f"{clock_ns(firmware.now)}"
        )

    def flush(self) -> None:
        """Hand over to the system what was noted, in whole lines."""
        if self._lines:
            self._file.write(("\n".join(self._lines) + "\n").encode("ascii"))
            self._file.flush()
            self._lines.clear()

    def close(self) -> None:
        """Write what is left and close."""
        self.flush()
        self._file.close()


class Server:
    """Serves a firmware, whose clock is the machine's monotonic clock, on TCP.

    Raises PortInUse, or UsageError for an address that cannot be listened on.
    """

    def __init__(
        self,
        host: str,
        port: int,
        firmware: Firmware,
        truth: TruthFile | None = None,
        say: Callable[[str], None] = print,
    ) -> None:
        self._listener = _listen(host, port)
        name = self._listener.getsockname()
        self.host, self.port = str(name[0]), int(name[1])
        self.connections = self.bytes_in = self.bytes_out = 0
        self.touched = False
        """Whether the rover ever touched anything."""
        self._truth, self._say = truth, say
        self._lateness = Lateness()
        self.firmware, self._start_s = firmware, firmware.now
        firmware.observe = self._observe
        self._client: socket.socket | None = None
        self._backlog = bytearray()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)

    def serve(self, stopping: Callable[[], bool], fault_lines: FileIO | None = None) -> None:
        """Serve until ``stopping``; each line of ``fault_lines`` is one more fault.

        Each line is answered by ``applied t_ns=… late_ns=…``: the simulation clock when the fault began, and
        how late the loop ended a turn at worst since the line before. An empty line asks only for the answer.
        """
        if fault_lines is not None:
            self._selector.register(fault_lines, selectors.EVENT_READ, lambda: self._read_fault(fault_lines))
        while not stopping():
            sleep_s = max(min(self.firmware.sip_due_s - time.monotonic(), PERIOD_S), 0.0)
            self._lateness.begin(sleep_s)
            for key, _ in self._selector.select(sleep_s):
                key.data()
            self.firmware.advance(time.monotonic())
            self._send()
            if self._truth:
                self._truth.flush()
            self._lateness.end()

    def close(self) -> None:
        """Hang up and close everything."""
        self._hang_up()
        self._selector.close()
        self._listener.close()
        if self._truth:
            self._truth.close()

    def _read_fault(self, fault_lines: FileIO) -> None:
        line = fault_lines.readline()
        if not line:
            self._selector.unregister(fault_lines)
            return
        text = line.decode(errors="replace").strip()
        try:
            fault = parse_fault(text) if text else None
        except UsageError as error:
            self._say(str(error))
            return
        self.firmware.advance(time.monotonic())
        if fault is not None:
            self.firmware.inject(fault)
        late_ns = clock_ns(self._lateness.take())
        self._say(f"applied t_ns={clock_ns(self.firmware.now)} late_ns={late_ns} {text}".rstrip())

    def _observe(self, now: float) -> None:
        contact = self.firmware.drive.rover.in_contact
        self.touched |= contact
        if self._truth:
            behind_ns = round((time.monotonic() - now) * 1e9)
            self._truth.add(self.firmware, time.time_ns() - behind_ns, now - self._start_s)

    def _accept(self) -> None:
        with suppress(OSError):
            client, _ = self._listener.accept()
            if self._client is not None:
                client.close()
                return
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._client = client
            self._backlog.clear()
            self.connections += 1
            self.firmware.line_changed()
            self._selector.register(client, selectors.EVENT_READ, self._receive)

    def _receive(self) -> None:
        if self._client is None:
            return
        try:
            data = self._client.recv(CHUNK_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._hang_up()
            return
        self.bytes_in += len(data)
        self.firmware.receive(data, time.monotonic())

    def _send(self) -> None:
        data = self.firmware.data_to_send()
        if self._client is None:
            return
        if len(self._backlog) + len(data) <= BACKLOG_BYTES:
            self._backlog += data
        if not self._backlog:
            return
        try:
            sent = self._client.send(self._backlog)
        except BlockingIOError:
            return
        except OSError:
            self._hang_up()
            return
        del self._backlog[:sent]
        self.bytes_out += sent

    def _hang_up(self) -> None:
        if self._client is not None:
            self._selector.unregister(self._client)
            self._client.close()
            self._client = None


def _listen(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen()
        listener.setblocking(False)
    except OSError as error:
        listener.close()
        if error.errno == errno.EADDRINUSE:
            raise PortInUse(f"--listen {host}:{port}: another process listens there") from error
        raise UsageError(f"--listen {host}:{port}: {error.strerror or error}") from error
    return listener
