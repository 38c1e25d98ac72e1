"""Link faults: a TCP proxy that holds, throttles or cuts the bytes that pass through it.

The proxy is a process of its own (``python proxy.py proxy HOST:PORT``), which `Proxy` starts. It
reads one command per line from its standard input, and ends with that input:

hold            hold the bytes to the server until ``release``, and then deliver them
hold_both_ways  hold the bytes in both directions, as if the cable were pulled
throttle BYTES  limit the bytes per second to the server
cut             close all connections, and refuse new ones
reset           break all connections by a TCP reset; accept new ones
release         end every fault of the link

An empty line has no effect. Each line is answered by ``applied t_ns=… late_ns=…``, as the mock does.
"""

import asyncio
import socket
import sys
import time
from contextlib import suppress
from functools import cached_property
from pathlib import Path

from bridge.pioneer.connection import ABORT
from sim.mock.real_time import Lateness
from sim.park.live import Applied, Process

CHUNK_BYTES = 1 << 16
TURN_S = 0.005
"""The loop wakes up so often; a turn that ends later shows how long the proxy had no CPU."""
PIECE_S = 0.05
"""A throttled link delivers so many seconds' worth of bytes at once."""


class Proxy(Process):
    """A proxy to ``target``, a HOST:PORT; clients connect to ``address``. `tell` injects a fault."""

    def __init__(self, target: str, folder: Path, name: str) -> None:
        super().__init__(name, [target], folder, __file__, reads_lines=True)

    @cached_property
    def address(self) -> str:
        """The address HOST:PORT, once the proxy listens. Raises ProcessError."""
        return self.wait_for_line("listening on ")


class _Link:
    """All connections to ``target``, each by its two ends, and the faults that are active."""

    def __init__(self, target: str) -> None:
        host, _, port = target.rpartition(":")
        self._target = (host, int(port))
        self._connections: set[tuple[asyncio.StreamWriter, ...]] = set()
        self._up_open, self._down_open = asyncio.Event(), asyncio.Event()
        self._bytes_s: int | None = None
        self._refusing = False
        self._lateness = Lateness()
        self._release()

    async def watch_delay(self) -> None:
        """Note the longest delay of the event loop."""
        while True:
            self._lateness.begin(TURN_S)
            await asyncio.sleep(TURN_S)
            self._lateness.end()

    def apply(self, line: str) -> Applied:
        """Apply a command line. The time returned is from before its effect: no fault looks younger."""
        word, _, number = line.strip().partition(" ")
        late_s = self._lateness.take()
        applied = Applied(time.monotonic_ns(), round(late_s * 1e9))
        if word in {"hold", "hold_both_ways"}:
            self._up_open.clear()
            if word == "hold_both_ways":
                self._down_open.clear()
        elif word == "throttle":
            self._bytes_s = int(number)
        elif word in {"cut", "reset"}:
            self._refusing = word == "cut"
            for end in (end for connection in self._connections for end in connection):
                if word == "reset":
                    end.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, ABORT)
                    end.transport.abort()
                end.close()
        elif word == "release":
            self._release()
        return applied

    async def connect(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one client until either end closes the connection."""
        try:
            if self._refusing:
                raise ConnectionRefusedError
            server_reader, server_writer = await asyncio.open_connection(*self._target)
        except OSError:
            writer.close()
            return
        connection = (writer, server_writer)
        self._connections.add(connection)
        pumps = [
            asyncio.create_task(self._pump_up(reader, server_writer)),
            asyncio.create_task(self._pump_down(server_reader, writer)),
        ]
        await asyncio.wait(pumps, return_when=asyncio.FIRST_COMPLETED)
        for pump in pumps:
            pump.cancel()
        for end in connection:
            end.close()
        self._connections.discard(connection)

    async def _pump_up(self, reader: asyncio.StreamReader, server: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            while data := await reader.read(CHUNK_BYTES):
                while data:
                    await self._up_open.wait()
                    if reader.exception() is not None:  # the client dropped what it had sent
                        return
                    size = len(data)
                    if self._bytes_s is not None:
                        size = min(size, max(round(self._bytes_s * PIECE_S), 1))
                        await asyncio.sleep(size / self._bytes_s)
                    server.write(data[:size])
                    await server.drain()
                    data = data[size:]

    async def _pump_down(self, reader: asyncio.StreamReader, client: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            while data := await reader.read(CHUNK_BYTES):
                await self._down_open.wait()
                client.write(data)
                await client.drain()
        # A held link does not show the client that the server is gone.
        await self._up_open.wait()

    def _release(self) -> None:
        self._up_open.set()
        self._down_open.set()
        self._bytes_s, self._refusing = None, False


async def _serve(target: str) -> None:
    link = _Link(target)
    server = await asyncio.start_server(link.connect, "127.0.0.1", 0)
    _say(f"listening on 127.0.0.1:{server.sockets[0].getsockname()[1]}")
    watch = asyncio.create_task(link.watch_delay())
    lines = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    async for line in lines:
        text = line.decode()
        applied = link.apply(text)
        _say(f"applied t_ns={applied.t_ns} late_ns={applied.late_ns} {text.rstrip()}")
    watch.cancel()


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    asyncio.run(_serve(sys.argv[2]))
