"""The live page: served to this machine alone, updated ten times a second, with a Stop button.

Rules of this file:

1. Each page has one WebSocket for updates and for its requests to stop. A browser limits the HTTP
   connections to a host to six, over all its pages; WebSockets are outside that limit.
2. A request to stop waits for nothing: neither for updates of this page nor for those of another.
3. A page requests the next updates when it has shown the last. A slow or hidden page thus queues nothing. The
   server does not rely on that: it answers few requests of a page at a time, reads no more of them meanwhile,
   and ends the connection of a page that takes nothing.
4. Only pages of this server may open the WebSocket: other pages in the same browser have another origin, and
   other names for this machine another host in the request.
"""

import asyncio
import contextlib
import json
import socket
import time
from collections.abc import Callable
from typing import Any

import uvicorn
from anyio import CapacityLimiter, Event, Semaphore, create_task_group
from anyio.to_thread import run_sync
from pydantic import Field
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from deploy.stop import StopClient
from deploy.view.feed import Cursor, Feed
from deploy.view.page import watch_page
from deploy.zenoh_client import BridgeAddress
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.config import ResultModel
from rover_ncp.core.console import Output
from rover_ncp.core.errors import (
    INTERRUPTED,
    FormatError,
    PortInUse,
    UnreachableError,
)
from rover_ncp.core.process import Interrupts
from rover_ncp.course.course import load_course
from rover_ncp.course.shapes import outline_of
from rover_ncp.course.slowdown import slowed
from rover_ncp.recording.recording import Recorded
from rover_ncp.robot.description import load_description
from rover_ncp.wire.key_table import TAG_VIEW, KeySpec, spec

HOST = "127.0.0.1"
REQUEST_BYTES = 16
"""The longest request of a page is "release"."""
STOPS_AT_ONCE = 64
ANSWERS_AT_ONCE = 4
"""Requests of one page that are answered at a time."""
SLOW_S = 10.0
"""A page that takes nothing of what waits for it for so long is closed."""
INVALID_DATA = 1007
"""WebSocket's code for a text that is not UTF-8."""
REASON = "the live page's Stop button"


class Viewer(StopClient):
    """One session with one bridge; ``take`` gets every message. Raises as `ZenohClient`."""

    def __init__(self, address: BridgeAddress, take: Callable[[Recorded], None]) -> None:
        def receive(row: KeySpec, data: bytes) -> None:
            now = time.monotonic_ns()
            with contextlib.suppress(FormatError):
                take(Recorded(row.name, row.type, data, now, now))

        super().__init__(address, receive, REASON)

    def _declare(self) -> None:
        self._receive_row(spec(TAG_VIEW))
        super()._declare()


class WatchResult(ResultModel):
    """What ``rover-ncp watch`` prints at its end."""

    address: str = Field(description="to open in a browser")
    robot: str = Field(description="the bridge's Zenoh address")


def run(address: BridgeAddress, policy: str, course: str, port: int, output: Output, *, model: str) -> int:
    """Serve until interrupted. Raises RoverNcpError if it could not begin."""
    robot = load_description(model)
    the_policy, (the_course, _) = load_policy(policy), slowed(load_course(course), robot)
    feed = Feed(the_policy, the_course)
    with _listener(port) as listener:
        port = listener.getsockname()[1]
        url = f"http://{HOST}:{port}/"
        outline = outline_of(robot)
        page = watch_page(address.robot, url, the_policy, the_course, outline)
        with Viewer(address, feed.take) as viewer:
            server = _server(_application(page, feed, viewer))
            output.announce(f"watching at {url}")
            # The server ends in order on a signal, and then raises the signal again.
            with Interrupts():
                server.run(sockets=[listener])
    result = WatchResult(address=url, robot=viewer.robot)
    output.result(result, "interrupted; no longer watching")
    return INTERRUPTED


class Connection(WebSocketsSansIOProtocol):
    """A page's WebSocket that ends without a word in the log when the page takes nothing or sends no text."""

    _slow: asyncio.TimerHandle | None = None

    def pause_writing(self) -> None:
        """Begin to wait for a page that does not take what was written."""
        super().pause_writing()
        self._slow = self.loop.call_later(SLOW_S, self.transport.abort)

    def resume_writing(self) -> None:
        """End the wait."""
        super().resume_writing()
        if self._slow is not None:
            self._slow.cancel()

    def send_receive_event_to_app(self) -> None:
        """Pass a request on, or end the connection if it is not UTF-8."""
        if self.curr_msg_data_type == "text":
            try:
                b"".join(self.frames).decode()
            except UnicodeDecodeError:
                self.conn.fail(INVALID_DATA)
                self.handle_parser_exception()
                return
        super().send_receive_event_to_app()


def _application(page: str, feed: Feed, viewer: Viewer) -> Starlette:
    """Return the web application."""
    stops = CapacityLimiter(STOPS_AT_ONCE)  # threads of their own, so that no page's updates delay a stop

    async def show(request: Request) -> Response:
        return HTMLResponse(page)

    async def live(socket: WebSocket) -> None:
        if socket.headers.get("origin") != f"http://{socket.headers.get('host')}":
            await socket.close()
            return
        await socket.accept()
        cursor, answers, closed = Cursor(), Semaphore(ANSWERS_AT_ONCE), Event()

        async def answer(request: str) -> None:
            if request == "updates":
                reply = await run_sync(_updates, feed, viewer, cursor)
            else:
                reply = await run_sync(_request_stop, viewer, request == "release", limiter=stops)
            try:
                await socket.send_text(reply)
            except (
                WebSocketDisconnect,
                RuntimeError,
            ):  # the second for each answer behind the first that failed
                closed.set()
            answers.release()

        async with create_task_group() as requests:
            while (message := await socket.receive())["type"] == "websocket.receive":
                request = message.get("text")
                # A page that was closed may have requested a stop before.
                if request in {"stop", "release"} or (request == "updates" and not closed.is_set()):
                    await answers.acquire()
                    requests.start_soon(answer, request)

    return Starlette(
        routes=[Route("/", show), WebSocketRoute("/live", live)],
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])],
    )


def _server(application: Starlette) -> uvicorn.Server:
    config = uvicorn.Config(
        application,
        ws=Connection,
        ws_max_size=REQUEST_BYTES,
        ws_per_message_deflate=False,
        log_config=None,
        log_level="warning",
        access_log=False,
        lifespan="off",
        timeout_graceful_shutdown=1,
    )
    return uvicorn.Server(config)


def _updates(feed: Feed, viewer: Viewer, cursor: Cursor) -> str:
    bridge = viewer.bridge_alive
    updates = feed.updates(cursor, bridge) | {"bridge": bridge, "mayStop": viewer.may_stop}
    return json.dumps(updates, allow_nan=False, separators=(",", ":"))


def _request_stop(viewer: Viewer, release: bool) -> str:
    try:
        answer: dict[str, Any] = {"stopped": viewer.stop(release).stopped}
    except UnreachableError as error:
        answer = {"error": str(error)}
    return json.dumps({"answer": answer})


def _listener(port: int) -> socket.socket:
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOST, port))
        listener.listen()  # from now on connections are accepted, before the server runs
    except OSError as error:
        listener.close()
        raise PortInUse(f"--port {port}: {HOST}:{port} cannot be listened on: {error.strerror}") from error
    return listener
