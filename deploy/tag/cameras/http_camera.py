"""A camera with an address: a stream of pictures as browsers show it, or one picture that is asked for again.

Cameras differ in what they send between two pictures: boundaries, lengths and line ends may be wrong or
missing. So the pictures of a stream are found by the markers of JPEG. Of the text before a picture only its
stamp counts. `requests` does the rest: redirects, passwords, chunks.
"""

import math
import re
import ssl
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple
from urllib.parse import SplitResult, unquote, urlsplit

import requests
from requests.auth import AuthBase, HTTPBasicAuth, HTTPDigestAuth
from urllib3.exceptions import HTTPError

from deploy.tag.cameras.camera import TIMEOUT_S, Picture, ReadCamera, decode_picture
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.errors import UsageError

MAX_PICTURE, MAX_HEAD = 8 << 20, 1 << 14
"""Most bytes of a picture, and of what is before the first one."""
CHUNK = 1 << 16
STAMP = "x-timestamp"
"""Header of a picture: its time in s by any clock, as mjpg-streamer and many other cameras send it."""
MAX_STAMP_S = 1e10
MIN_PERIOD_S = 0.1
"""Time between two requests for pictures."""
RETRY_S = 2.0
"""Time after the last picture in which a camera is asked again: below `TIMEOUT_S`, which has no reason."""
JPEG = b"\xff\xd8\xff"
START, END, SCAN = 0xD8, 0xD9, 0xDA
"""Markers of a JPEG: its start, its end, and the start of a scan, whose data have no length."""
_AFTER_SCAN = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")
_STAMP = re.compile(rb"x-timestamp:[ \t]*([^\r\n]*)", re.IGNORECASE)


class HttpCamera(ReadCamera):
    """Reads ``http://`` and ``https://``; a name and a password in the address are in no message.

    The camera is read directly, never through a proxy. Raises UsageError for an address of another form.
    """

    def __init__(self, source: str, left_out: Counter[str]) -> None:
        parts = _address(source)
        host = parts.netloc.rpartition("@")[2]
        # A query may hold a password, too.
        super().__init__(f"{parts.scheme}://{host}{parts.path}{'?...' if parts.query else ''}", left_out)
        self._url = parts._replace(netloc=host, fragment="").geturl()
        self._login = None
        if parts.username is not None:
            self._login = unquote(parts.username), unquote(parts.password or "")
        self._auth: AuthBase | None = None
        self.start()

    def _pictures(self) -> Iterator[Callable[[], Picture]]:
        seen_s = -math.inf
        with requests.Session() as session:
            session.trust_env = False  # no proxy, no password of ~/.netrc
            while True:
                began_s = time.monotonic()
                try:
                    for picture in self._connected(session):
                        seen_s = time.monotonic()
                        yield picture
                    ended = "it sends no more pictures"
                # LookupError: a challenge without a realm.
                except (OSError, HTTPError, LookupError) as error:
                    ended = _reason(error)
                except ValueError as error:
                    ended = str(error)
                # Many cameras close the connection after a picture, or for a moment.
                if time.monotonic() - seen_s > RETRY_S:
                    raise ValueError(ended)
                time.sleep(max(0.0, began_s + MIN_PERIOD_S - time.monotonic()))

    def _connected(self, session: requests.Session) -> Iterator[Callable[[], Picture]]:
        """Yield the pictures of one connection: of a stream, or a single one."""
        reader = PictureReader()
        with self._answer(session) as response:
            kind = response.headers.get("content-type", "").partition(";")[0] or "other data"
            if packed := response.headers.get("content-encoding", ""):
                kind += f" ({packed})"
            while more := response.raw.read1(CHUNK):
                wall_ns = time.time_ns()
                for found in reader.feed(more, kind):
                    if isinstance(found, str):
                        self.leave_out(found)
                        continue
                    stamp = found.stamp or response.headers.get(STAMP)
                    if (moment_ns := self.moment_ns(_stamp_ns(stamp), wall_ns)) is not None:
                        yield partial(decode_picture, found.data, moment_ns)
        if not reader.began and kind.startswith("multipart/"):
            raise ValueError("its stream ended before the first picture")
        if not reader.began:
            raise ValueError(
                f"it sends {kind}, no JPEG: give the address of its stream or its "
                "picture, such as http://HOST:81/stream"
            )

    def _answer(self, session: requests.Session) -> requests.Response:
        """Return the answer to a request. Raises ValueError for one that is an error."""

        def get() -> requests.Response:
            headers = {"Accept-Encoding": "identity"}
            return session.get(self._url, stream=True, timeout=TIMEOUT_S, auth=self._auth, headers=headers)

        response = get()
        if response.status_code == requests.codes.unauthorized and self._login and self._auth is None:
            kinds = response.headers.get("www-authenticate", "").lower()
            response.close()
            name, password = self._login
            if "digest" in kinds:
                self._auth = HTTPDigestAuth(name, password)
            else:
                self._auth = HTTPBasicAuth(name.encode(), password.encode())
            response = get()
        if response.ok:
            return response
        code = response.status_code
        response.close()
        if code != requests.codes.unauthorized:
            raise ValueError(f"it answers HTTP {code}: is the path right?")
        if self._login:
            raise ValueError("it refuses this name and password")
        raise ValueError("it asks for a password: give http://NAME:PASSWORD@HOST/PATH")


def _address(source: str) -> SplitResult:
    try:
        parts = urlsplit(source)
        wrong = parts.scheme not in {"http", "https"} or not parts.hostname or parts.port == 0
    except ValueError:
        wrong = True
    if wrong:  # the address may hold a password
        raise UsageError(
            "--camera: the address cannot be read; expected http://[NAME:PASSWORD@]HOST[:PORT]/PATH, in a "
            "password %2F for /, %3F for ?, %23 for #; a camera of another protocol (rtsp) is not read"
        )
    return parts


def _reason(error: BaseException) -> str:
    """Return why a request failed: libraries' own words name the whole address."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, TimeoutError | requests.Timeout):
            return f"no answer for {TIMEOUT_S:g} s"
        if isinstance(cause, ssl.SSLCertVerificationError):
            return f"its certificate is not trusted ({cause.verify_message}): use http:// if it offers that"
        if isinstance(cause, OSError) and cause.strerror:
            return cause.strerror
        last, cause = cause, cause.__cause__ or cause.__context__
    known = {
        "BadStatusLine": "it does not speak HTTP",
        "KeyError": "its request for a password names no realm",
        "TooManyRedirects": "it redirects for ever",
        "InvalidSchema": "it redirects to an address that is neither http nor https",
    }
    return known.get(type(last).__name__, f"the connection failed ({type(last).__name__})")


class Found(NamedTuple):
    """A picture of a stream, with the stamp of its header."""

    stamp: str | None
    data: bytes


class PictureReader:
    """Finds the JPEG pictures of a stream. Pure; holds no more than a picture and the text before it."""

    def __init__(self) -> None:
        self._buffer, self._head = bytearray(), b""
        self._at = self._scanned = 0
        """Where the next marker of the present picture is, 0 between pictures; where its scan goes on."""
        self.began = False
        """Whether there was a picture."""

    def feed(self, data: bytes, kind: str = "data") -> Iterator[Found | str]:
        """Yield the pictures that ``data`` completes, and why others are left out.

        Raises ValueError, which names the ``kind`` of data, if no picture begins.
        """
        buffer = self._buffer
        buffer += data
        while self._at or self._begin(kind):
            complete = self._walk()
            if complete is None and len(buffer) <= MAX_PICTURE:
                return
            if complete:
                yield Found(_stamp(self._head), bytes(buffer[: self._at]))
                del buffer[: self._at]
            else:
                large = f"a picture of more than {MAX_PICTURE >> 20} MiB"
                yield "a picture is damaged" if complete is False else large
                del buffer[: len(JPEG)]
            self._at = self._scanned = 0

    def _begin(self, kind: str) -> bool:
        """Drop what is before the next picture but for its header; return whether one begins."""
        at = self._buffer.find(JPEG)
        if at >= 0:
            self._head, self._at, self.began = bytes(self._buffer[max(at - MAX_HEAD, 0) : at]), 2, True
            del self._buffer[:at]
        elif len(self._buffer) > MAX_HEAD:
            if not self.began:
                raise ValueError(f"no JPEG begins within {MAX_HEAD} bytes of {kind}")
            del self._buffer[:-MAX_HEAD]
        return at >= 0

    def _walk(self) -> bool | None:
        """Go to the end of the picture: True if it is there, False if the picture is damaged, else None."""
        buffer = self._buffer
        while self._at + 2 <= len(buffer):
            marker, length = buffer[self._at + 1], int.from_bytes(buffer[self._at + 2 : self._at + 4], "big")
            if buffer[self._at] != 0xFF or marker == START:
                return False
            if marker == END:
                self._at += 2
                return True
            if self._at + 4 > len(buffer):
                return None
            if marker == SCAN:
                scanned = max(self._at + 2 + length, self._scanned)
                if (found := _AFTER_SCAN.search(buffer, scanned)) is None:
                    self._scanned = max(scanned, len(buffer) - 1)
                    return None
                self._at = found.start()
            else:
                self._at += 2 + length
        return None


def _stamp(head: bytes) -> str | None:
    """Return the stamp in what is before a picture, the last one."""
    found = _STAMP.findall(head)
    return found[-1].decode("latin-1") if found else None


def _stamp_ns(stamp: str | None) -> int | None:
    try:
        seconds = float(stamp or "")
    except ValueError:
        return None
    return round(seconds * NS_PER_S) if math.isfinite(seconds) and 0.0 < seconds < MAX_STAMP_S else None
