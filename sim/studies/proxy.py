"""A link that can be spoilt: a TCP proxy that holds back, slows down or cuts what goes through it.

One thread moves all bytes. Towards the server they may be held (nothing passes until `release`, then all of
it does), throttled, or cut; towards the client they pass freely unless cut, as a link whose one direction is
congested.
"""

import selectors
import socket
import threading
import time
from contextlib import suppress
from types import TracebackType
from typing import Self

__all__ = ["Proxy"]

CHUNK_BYTES = 1 << 16
TURN_S = 0.005


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


class Proxy:
    """Listens on ``port`` of this machine and passes on to ``target``, a HOST:PORT."""

    def __init__(self, target: str) -> None:
        host, _, port = target.rpartition(":")
        self._target = (host, int(port))
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        self._pairs: list[_Pair] = []
        self._lock = threading.Lock()
        self._held = self._cut = False
        self._bytes_s: float | None = None
        self._credit, self._credit_s = 0.0, time.monotonic()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="proxy", daemon=True)
        self._thread.start()

    def hold(self) -> None:
        """Let nothing more through to the server; it is kept."""
        with self._lock:
            self._held = True

    def throttle(self, bytes_s: float | None) -> None:
        """Let so many bytes a second through to the server; None for all."""
        with self._lock:
            self._bytes_s, self._credit, self._credit_s = bytes_s, 0.0, time.monotonic()

    def cut(self) -> None:
        """Break all connections, and refuse new ones."""
        with self._lock:
            self._cut = True
            self._drop_all()

    def release(self) -> None:
        """Pass on all that was held, and be a good link again."""
        with self._lock:
            self._held = self._cut = False
            self._bytes_s = None

    def close(self) -> None:
        """End it, and every connection through it."""
        self._closing.set()
        self._thread.join()
        self._drop_all()
        self._listener.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _drop_all(self) -> None:
        for pair in self._pairs:
            pair.close()
        self._pairs.clear()

    def _run(self) -> None:
        while not self._closing.is_set():
            with self._lock:
                waiting = [
                    self._listener,
                    *(end for pair in self._pairs for end in (pair.client, pair.server)),
                ]
            with selectors.DefaultSelector() as selector:
                for end in waiting:
                    with suppress(ValueError, OSError):  # closed meanwhile
                        selector.register(end, selectors.EVENT_READ)
                selector.select(TURN_S)
            with self._lock:
                self._accept()
                for pair in list(self._pairs):
                    if not self._turn(pair):
                        pair.close()
                        self._pairs.remove(pair)

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
        """Move what there is to move; False when an end is gone."""
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
            _write(pair.client, pair.down, len(pair.down))
        except OSError:
            return False
        self._credit -= sent
        # What was sent before an end was closed still arrives, as it does on a network.
        return open_ or bool(pair.up and self._held)


def _read(end: socket.socket, buffer: bytearray) -> bool:
    """Read what there is; False at the end of the stream."""
    try:
        data = end.recv(CHUNK_BYTES)
    except BlockingIOError:
        return True
    except OSError:
        return False
    buffer += data
    return bool(data)


def _write(end: socket.socket, buffer: bytearray, size: int) -> int:
    """Write up to ``size`` bytes; return how many went. Raises OSError when the end is gone."""
    if size <= 0:
        return 0
    try:
        sent = end.send(memoryview(bytes(buffer[:size])))
    except BlockingIOError:
        return 0
    del buffer[:sent]
    return sent
