"""The live page's WebSocket without a network: who may open it, and a page that is closed."""

import asyncio
from types import SimpleNamespace

import pytest

from deploy.view.server import _application


class Viewer:
    """A viewer whose requests to stop count."""

    def __init__(self):
        self.stops = 0

    def stop(self, release):
        self.stops += 1
        return SimpleNamespace(stopped=not release)


def converse(requests, origin="http://127.0.0.1:8000", host="127.0.0.1:8000", gone=False):
    """Open a WebSocket and send requests; return what the server sent, and how often it requested a stop."""
    headers = [(b"host", host.encode()), *([(b"origin", origin.encode())] if origin is not None else [])]
    scope = {"type": "websocket", "path": "/live", "headers": headers, "subprotocols": []}
    arrivals = [
        {"type": "websocket.connect"},
        *({"type": "websocket.receive", "text": request} for request in requests),
        {"type": "websocket.disconnect", "code": 1001},
    ]
    sent, viewer = [], Viewer()

    async def receive():
        return arrivals.pop(0)

    async def send(message):
        if gone and message["type"] == "websocket.send":
            raise OSError("the page is gone")
        sent.append(message["type"])

    application = _application("", SimpleNamespace(), viewer)
    asyncio.run(application(scope, receive, send))
    return sent, viewer.stops


def test_page_of_this_server_may_stop():
    assert converse(["stop", "x", "release"]) == (["websocket.accept", *["websocket.send"] * 2], 2)


@pytest.mark.parametrize(
    ("origin", "host"),
    [
        (None, "127.0.0.1:8000"),
        ("http://evil.example", "127.0.0.1:8000"),
        ("http://127.0.0.1:9000", "127.0.0.1:8000"),
        ("http://evil.example:8000", "evil.example:8000"),
    ],
)
def test_other_pages_may_not(origin, host):
    sent, stops = converse(["stop"], origin, host)
    assert "websocket.accept" not in sent
    assert stops == 0


def test_requests_of_a_page_that_is_closed_stop_the_rover_without_an_error():
    assert converse(["stop"] * 3, gone=True) == (["websocket.accept"], 3)
