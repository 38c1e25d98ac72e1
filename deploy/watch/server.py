"""The live page: served to this machine alone, updated ten times a second, with a Stop button.

Server-sent events carry new data; a browser that lost the connection reconnects and gets everything.
Only pages of this server may press its buttons: other pages in the same browser have another origin, and
other names for this machine another host in the request.
"""

import asyncio
import json
import socket
import time
from collections.abc import AsyncIterator, Callable
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from deploy.report.charts.figure import outline_of
from deploy.report.page.feed import Feed, Place
from deploy.report.page.page import watch_page
from deploy.watch.viewer import Viewer
from deploy.zenoh_client import BridgeAddress
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.console import Output
from rover_ncp.core.errors import PortInUse, UnreachableError
from rover_ncp.core.process import Interrupts
from rover_ncp.core.robot_description import load_description
from rover_ncp.course.course import load_course

HOST = "127.0.0.1"
INTERRUPTED = 130
PERIOD_S = 0.1


def run(address: BridgeAddress, policy: str, course: str, port: int, output: Output, *, model: str) -> int:
    """Serve until interrupted. Raises RoverNcpError if it could not begin."""
    the_policy, the_course = load_policy(policy), load_course(course)
    feed = Feed(the_policy, the_course)
    page = watch_page(address.robot, the_policy, the_course, outline_of(load_description(model)))
    with _listener(port) as listener, Viewer(address, feed.take) as viewer:
        url = f"http://{HOST}:{listener.getsockname()[1]}/"
        application = _application(page, feed, viewer, ending=lambda: server.should_exit)
        config = uvicorn.Config(
            application, log_level="warning", access_log=False, lifespan="off", timeout_graceful_shutdown=1
        )
        server = uvicorn.Server(config)
        output.announce(f"watching at {url}")
        # The server ends in order on a signal, and then raises the signal again.
        with Interrupts():
            server.run(sockets=[listener])
    output.result({"address": url, "robot": viewer.robot}, "interrupted; no longer watching")
    return INTERRUPTED


def _application(page: str, feed: Feed, viewer: Viewer, ending: Callable[[], bool]) -> Starlette:
    """Return the web application. Streams of events end soon after ``ending`` returns True."""

    async def show(request: Request) -> Response:
        return HTMLResponse(page)

    async def events(request: Request) -> Response:
        return StreamingResponse(_events(feed, viewer, ending), media_type="text/event-stream")

    async def stop(request: Request) -> Response:
        return await _request_stop(request, viewer, release=False)

    async def release(request: Request) -> Response:
        return await _request_stop(request, viewer, release=True)

    return Starlette(
        routes=[
            Route("/", show),
            Route("/events", events),
            Route("/stop", stop, methods=["POST"]),
            Route("/release", release, methods=["POST"]),
        ],
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])],
    )


async def _events(feed: Feed, viewer: Viewer, ending: Callable[[], bool]) -> AsyncIterator[str]:
    place = Place()
    yield "retry: 500\n\n"
    while not ending():
        bridge = viewer.bridge_alive
        news: dict[str, Any] = await run_in_threadpool(feed.news, place, bridge)
        news |= {"bridge": bridge, "mayStop": viewer.may_stop}
        yield f"data: {json.dumps(news, allow_nan=False, separators=(',', ':'))}\n\n"
        await asyncio.sleep(PERIOD_S)


async def _request_stop(request: Request, viewer: Viewer, release: bool) -> Response:
    if request.headers.get("origin") != f"{request.url.scheme}://{request.headers.get('host')}":
        return JSONResponse({"error": "only the page itself may do this"}, 403)
    began_s = time.monotonic()
    try:
        reply = await run_in_threadpool(viewer.stop, release)
    except UnreachableError as error:
        return JSONResponse({"error": str(error)}, 502)
    return JSONResponse({"stopped": reply.stopped, "took_s": time.monotonic() - began_s})


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
