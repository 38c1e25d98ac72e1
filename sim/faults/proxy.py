"""Link faults: a TCP proxy that holds, throttles or cuts the bytes that pass through it.

The proxy is a process of its own (``python -m sim.faults.proxy proxy HOST:PORT``), which `Proxy` starts. It
reads one command per line from its standard input, and ends with that input. Bytes towards the server may be
held (none pass until ``release``, then all do), throttled, or cut. Bytes towards the client pass unless the
link is cut or held both ways. ``silence`` cuts the server off from its clients, whose connections stay open.
The proxy answers each line by ``applied t_ns=… late_ns=…``, as the mock does. An empty line requests only the
answer.
"""

import math
import selectors
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property
from pathlib import Path

from sim.live.processes import Applied, Process

CHUNK_BYTES = 1 << 16
TURN_S = 0.005
ABORT = struct.pack("ii", 1, 0)
"""SO_LINGER: close by a reset, whatever is still on its way."""


class Proxy(Process):
    """A proxy to ``target``, a HOST:PORT; clients connect to ``address``."""

    def __init__(self, target: str, folder: Path, name: str) -> None:
        super().__init__(name, [target], folder, "sim.faults.proxy", reads_lines=True)

    @cached_property
    def address(self) -> str:
        """The address HOST:PORT, once the proxy listens. Raises ProcessError."""
        return self.wait_for_line("listening on ")

    def hold(self) -> Applied:
        """Buffer all bytes to the server until ``release``."""
        return self.tell("hold")

    def hold_both_ways(self) -> Applied:
        """Buffer all bytes in both directions, as if the cable were pulled."""
        return self.tell("hold_both_ways")

    def silence(self) -> Applied:
        """Cut present clients off from the server, with their connections open; new connections pass."""
        return self.tell("silence")

    def throttle(self, bytes_s: int) -> Applied:
        """Limit the bytes per second to the server."""
        return self.tell(f"throttle {bytes_s}")

    def cut(self) -> Applied:
        """Break all connections, and refuse new ones."""
        return self.tell("cut")

    def reset(self) -> Applied:
        """Break all connections by a TCP reset; accept new ones."""
        return self.tell("reset")

    def release(self) -> Applied:
        """Pass on all held bytes, and end every fault of the link."""
        return self.tell("release")


class _Pair:
    """One connection through the proxy."""

    def __init__(self, client: socket.socket, server: socket.socket) -> None:
        self.client, self.server = client, server
        self.up, self.down = bytearray(), bytearray()
        for end in (client, server):
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            end.setblocking(False)

    def close(self) -> None:
        self.client.close()
        self.server.close()

    def abort(self) -> None:
        for end in (self.client, self.server):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, ABORT)
        self.close()


class _Server:
    """Listens on a port of this machine and passes on to ``target``; one thread moves all bytes."""

    def __init__(self, target: str) -> None:
        host, _, port = target.rpartition(":")
        self._target = (host, int(port))
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        self._pairs: list[_Pair] = []
        self._silenced: list[socket.socket] = []
        self._lock = threading.Lock()
        self._held = self._held_back = self._cut = False
        self._bytes_s: float | None = None
        self._credit, self._credit_s = 0.0, time.monotonic()
        self._due_s, self._late_s = math.inf, 0.0
        threading.Thread(target=self._run, name="proxy", daemon=True).start()

    def obey(self, line: str) -> Applied:
        """Apply a command line. The time returned is from before its effect: no fault looks younger."""
        word, _, number = line.strip().partition(" ")
        with self._lock:
            # The delay of the turn under way was before this line, not after it.
            late_s = max(self._late_s, time.monotonic() - self._due_s)
            self._due_s, self._late_s = time.monotonic() + TURN_S, 0.0
            applied = Applied(time.monotonic_ns(), round(late_s * 1e9))
            if word in {"hold", "hold_both_ways"}:
                self._held, self._held_back = True, word == "hold_both_ways"
            elif word == "silence":
                self._silenced += [pair.client for pair in self._pairs]
                self._drop_all(lambda pair: pair.server.close())
            elif word == "throttle":
                self._bytes_s, self._credit, self._credit_s = float(number), 0.0, time.monotonic()
            elif word == "cut":
                self._cut = True
                self._drop_all(_Pair.close)
            elif word == "reset":
                self._drop_all(_Pair.abort)
            elif word == "release":
                self._held = self._held_back = self._cut = False
                self._bytes_s = None
        return applied

    def _drop_all(self, close: Callable[[_Pair], None]) -> None:
        for pair in self._pairs:
            close(pair)
        self._pairs.clear()

    def _run(self) -> None:
        while True:
            with self._lock:
                waiting = [
                    self._listener,
                    *(end for pair in self._pairs for end in (pair.client, pair.server)),
                ]
            with selectors.DefaultSelector() as selector:
                for end in waiting:
                    with suppress(ValueError, OSError):  # closed meanwhile
                        selector.register(end, selectors.EVENT_READ)
                self._due_s = time.monotonic() + TURN_S
                selector.select(TURN_S)
            with self._lock:
                self._accept()
                for pair in list(self._pairs):
                    if not self._turn(pair):
                        pair.close()
                        self._pairs.remove(pair)
                self._late_s = max(self._late_s, time.monotonic() - self._due_s)

    def _accept(self) -> None:
        with suppress(BlockingIOError):
            client, _ = self._listener.accept()
            try:
                if self._cut:
                    raise ConnectionRefusedError
                self._pairs.append(_Pair(client, socket.create_connection(self._target, 1.0)))
            except OSError:
                client.close()

    def _turn(self, pair: _Pair) -> bool:
        """Move available bytes; return False when an end is closed."""
        ends = ((pair.client, pair.up), (pair.server, pair.down))
        open_ = [_read(end, buffer) for end, buffer in ends] == [True, True]
        allowance = len(pair.up)
        if self._held:
            allowance = 0
        elif self._bytes_s is not None:
            now = time.monotonic()
            self._credit += self._bytes_s * (now - self._credit_s)
            self._credit_s = now
            allowance = min(allowance, int(self._credit))
        try:
            sent = _write(pair.server, pair.up, allowance)
            if not self._held_back:
                _write(pair.client, pair.down, len(pair.down))
        except OSError:
            return False
        self._credit -= sent
        # Bytes sent before an end was closed still arrive, as on a network.
        return open_ or bool(pair.up and self._held)


def _read(end: socket.socket, buffer: bytearray) -> bool:
    """Read available bytes; return False at the end of the stream."""
    try:
        data = end.recv(CHUNK_BYTES)
    except BlockingIOError:
        return True
    except OSError:
        return False
    buffer += data
    return bool(data)


def _write(end: socket.socket, buffer: bytearray, size: int) -> int:
    """Write up to ``size`` bytes; return how many were sent. Raises OSError when the end is closed."""
    if size <= 0:
        return 0
    try:
        sent = end.send(memoryview(bytes(buffer[:size])))
    except BlockingIOError:
        return 0
    del buffer[:sent]
    return sent


if __name__ == "__main__":
    server = _Server(sys.argv[2])
    print(f"listening on 127.0.0.1:{server.port}", file=sys.stderr, flush=True)
    for line in sys.stdin:
        applied = server.obey(line)
        print(
            f"applied t_ns={applied.t_ns} late_ns={applied.late_ns} {line.rstrip()}",
            file=sys.stderr,
            flush=True,
        )
