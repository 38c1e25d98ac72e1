"""A camera with an address: a stream of pictures as browsers show it, or one picture that is asked for again.

Cameras differ: the boundary may be missing, quoted or with dashes, parts may have no length, lines may end
with LF, stamps may be of any clock. `requests` does the rest: redirects, passwords, chunks.
"""

import math
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator
from email.message import Message
from email.parser import BytesHeaderParser
from functools import partial
from typing import NamedTuple
from urllib.parse import SplitResult, unquote, urlsplit

import requests
from requests.auth import AuthBase, HTTPBasicAuth, HTTPDigestAuth
from urllib3.exceptions import HTTPError

from deploy.tag.camera import TIMEOUT_S, Picture, ReadCamera, decode_picture
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.errors import UsageError

MAX_PART, MAX_HEAD = 8 << 20, 1 << 14
"""Most bytes of a picture, and of what is before one: its header, or the beginning of the stream."""
CHUNK = 1 << 16
SURE = 6
"""A boundary of so many bytes is in no picture by chance."""
STAMP = "x-timestamp"
"""Header of a picture: its time in s by any clock, as mjpg-streamer and many other cameras send it."""
MAX_STAMP_S = 1e10
MIN_PERIOD_S = 0.1
"""Time between two requests for single pictures."""
JPEG, JPEG_END, PNG = b"\xff\xd8", b"\xff\xd9", b"\x89PNG"


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
        try:
            with requests.Session() as session:
                session.trust_env = False  # no proxy, no password of ~/.netrc
                while True:
                    began_s = time.monotonic()
                    with self._answer(session) as response:
                        read = partial(response.raw.read1, CHUNK)
                        first, wall_ns = b"", time.time_ns()
                        while len(first.lstrip()) < len(PNG) and (more := read()):
                            first, wall_ns = first + more, time.time_ns()
                        if not first.lstrip().startswith((JPEG, PNG)):
                            yield from self._stream(first, read, response.headers.get("content-type", ""))
                            return
                        data = _whole(first, read)
                        yield from self._picture(data, response.headers.get(STAMP), wall_ns)
                    time.sleep(max(0.0, began_s + MIN_PERIOD_S - time.monotonic()))
        except (requests.RequestException, HTTPError, LookupError) as error:  # a challenge without a realm
            raise ValueError(_reason(error)) from error

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

    def _stream(
        self, first: bytes, read: Callable[[], bytes], content: str
    ) -> Iterator[Callable[[], Picture]]:
        kind = Message()
        kind["content-type"] = content
        if kind.get_content_maintype() != "multipart" and not first.lstrip().startswith(b"--"):
            told = f"{kind.get_content_type()}, no pictures" if first else "nothing"
            raise ValueError(
                f"it sends {told}: give the address of its stream or its picture, such as "
                "http://HOST:81/stream"
            )
        parts, more = PartReader(str(kind.get_param("boundary", ""))), first
        while more:
            for part in parts.feed(more):
                if isinstance(part, str):
                    self.leave_out(part)
                else:
                    yield from self._picture(part.data, part.header.get(STAMP), time.time_ns())
            more = read()

    def _picture(self, data: bytes, stamp: str | None, wall_ns: int) -> Iterator[Callable[[], Picture]]:
        data = data.lstrip(b"\r\n")
        if not data.startswith((JPEG, PNG)):
            self.leave_out("a part is neither a JPEG nor a PNG")
        elif (moment_ns := self.moment_ns(_stamp_ns(stamp), wall_ns)) is not None:
            yield partial(decode_picture, data, moment_ns)


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


def _whole(first: bytes, read: Callable[[], bytes]) -> bytes:
    """Return a whole answer. Raises ValueError if it is too long."""
    data = bytearray(first)
    while more := read():
        data += more
        if len(data) > MAX_PART:
            raise ValueError(f"a picture of more than {MAX_PART >> 20} MiB")
    return bytes(data)


def _reason(error: BaseException) -> str:
    """Return why a request failed: libraries' own words name the whole address."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, TimeoutError | requests.Timeout):
            return f"no answer for {TIMEOUT_S:g} s"
        if isinstance(cause, OSError) and cause.strerror:
            return cause.strerror
        last, cause = cause, cause.__cause__ or cause.__context__
    known = {"BadStatusLine": "it does not speak HTTP", "TooManyRedirects": "it redirects for ever"}
    return known.get(type(last).__name__, f"the connection failed ({type(last).__name__})")


class Part(NamedTuple):
    """A part of a stream."""

    header: Message
    data: bytes


class PartReader:
    """Splits a stream into its parts. Pure; holds no more than a part and its header.

    The first line that begins with two dashes, or is the ``boundary`` that was declared, parts them. A part
    ends after its Content-Length, at the next boundary, or with the end of a JPEG, whichever comes first: a
    camera may send the boundary with the next picture only.
    """

    def __init__(self, boundary: str) -> None:
        self._declared, self._boundary = boundary.strip().encode("latin-1", "replace"), b""
        self._buffer, self._head = bytearray(), list[bytes]()
        self._header: Message | None = None
        self._between, self._skipped, self._searched = True, 0, 0

    def feed(self, data: bytes) -> Iterator[Part | str]:
        """Yield the parts that ``data`` completes, and why others are left out.

        Raises ValueError if no part begins.
        """
        self._buffer += data
        while True:
            found = self._read_data() if self._header is not None else self._read_line()
            if found is None:
                return
            if found:
                yield found

    def _read_line(self) -> str | None:
        """Take a line between parts or of a header; "" if that was all, None if more bytes are needed."""
        if self._between and self._boundary:
            at = self._buffer.find(self._boundary)
            del self._buffer[: at if at >= 0 else -len(self._boundary)]
        end = self._buffer.find(b"\n")
        size = len(self._buffer) if end < 0 else end + 1
        self._skipped += size if end >= 0 or size > MAX_HEAD else 0
        if not self._boundary and self._skipped > MAX_HEAD:
            raise ValueError(f"no part of its stream begins within {MAX_HEAD} bytes")
        if end < 0 and size <= MAX_HEAD:
            return None
        line = bytes(self._buffer[: min(size, MAX_HEAD)]).strip()
        del self._buffer[:size]
        if self._begins(line):
            self._between, self._skipped, self._head = False, 0, []
        elif self._between:
            return ""
        elif self._skipped > MAX_HEAD:
            self._between, self._head = True, []
            return f"a part whose header has more than {MAX_HEAD} bytes"
        elif line:
            self._head.append(line)
        else:
            self._header, self._searched = BytesHeaderParser().parsebytes(b"\n".join(self._head)), 0
        return ""

    def _begins(self, line: bytes) -> bool:
        if not self._boundary and (
            (line.startswith(b"--") and len(line) > 2) or (len(line) > 0 and line == self._declared)
        ):
            self._boundary = line
        return bool(line) and line in {self._boundary, self._boundary + b"--"}

    def _read_data(self) -> Part | str | None:
        assert self._header is not None
        buffer, length = self._buffer, _length(self._header)
        # A long boundary needs no line of its own: some cameras send none before it.
        mark = self._boundary if len(self._boundary) >= SURE else b"\n" + self._boundary
        at = buffer.find(mark, self._searched, MAX_PART)
        if length is not None and len(buffer) >= length and not 0 <= at < length:
            end = length
        elif at >= 0:
            end = at
        elif length is None and buffer.endswith((JPEG_END, JPEG_END + b"\r\n", JPEG_END + b"\n")):
            end = len(buffer)
        elif len(buffer) > MAX_PART:
            self._header, self._between = None, True
            return f"a picture of more than {MAX_PART >> 20} MiB"
        else:
            self._searched = max(0, len(buffer) - len(mark))
            return None
        data = bytes(buffer[:end])
        part = Part(self._header, data if end == length else data.rstrip(b"\r\n"))
        del buffer[:end]
        self._header, self._between = None, True
        return part


def _length(header: Message) -> int | None:
    text = str(header.get("content-length", "")).strip()
    return int(text) if re.fullmatch(r"\d{1,7}", text) and 0 < int(text) <= MAX_PART else None


def _stamp_ns(stamp: str | None) -> int | None:
    try:
        seconds = float(str(stamp or ""))  # with other bytes than ASCII it is no str
    except ValueError:
        return None
    return round(seconds * NS_PER_S) if math.isfinite(seconds) and 0.0 < seconds < MAX_STAMP_S else None
