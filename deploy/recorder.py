"""Recording beside the drive: a thread of its own, so that no disk ever blocks the control loop.

Messages are handed over through a bounded queue. A message that finds it full is counted as dropped, and so
is one that no recording can hold, such as one with a negative time. Pictures for people are dropped first,
when only a few messages wait. When the disk fails, recording ends,
`Recorder.failure` gives the reason, and the drive goes on. The file so far stays readable. A killed process
loses at most the messages after the last flush, a power cut those after the last sync: the thread does both
every `FLUSH_S`.

A recording is kept once its drive has begun (`Recorder.begin`). It never replaces a file.
"""

import contextlib
import logging
import os
import queue
import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field

from rover_ncp.core.errors import FileError
from rover_ncp.core.files import require_writable
from rover_ncp.core.process import ClosedAtExit
from rover_ncp.recording.recording import Recorded, RecordingWriter
from rover_ncp.wire.key_table import KEYS

_log = logging.getLogger(__name__)
FLUSH_S = 0.4
"""Leaves a tenth of a second for the queue and the disk: a killed process loses at most 0.5 s."""
STAMPED_NS = 1_000_000_000
"""A message whose log time is further away was dated on purpose, such as a path at the drive's start."""
QUEUE_LENGTH = 10_000
"""A minute of everything the bridge publishes."""
BEHIND = 500
"""Messages that wait when the recorder is 3 s behind: it then takes no pictures."""
CLOSE_TIMEOUT_S = 10.0
SHOWN = frozenset(row.name for row in KEYS if row.shown)
"""Topics for people alone, which no drive needs."""


class RecordingResult(BaseModel):
    """The recording in a command's result."""

    recording: str | None = Field(description="its file")
    recording_failure: str | None = Field(description="why it is not whole")


class Recorder(ClosedAtExit):
    """Writes one recording, or none for the path None. Only `open` and the constructor raise.

    Messages that come before `open`, such as the static transforms, wait in the queue.
    """

    def __init__(self, path: Path | None) -> None:
        """In a folder the recording is named by the time.

        Raise FileError if a file exists at ``path``, or if none could be made there.
        """
        if path is not None and os.path.isdir(path):  # noqa: PTH112  # a name that is too long is none
            path /= f"{datetime.now():%Y-%m-%d_%H-%M-%S}.mcap"
        if path is not None:
            if os.path.lexists(path):
                words = "exists already; choose another name (in a folder the time is the name)"
                raise FileError(f"{path}: {words}: a recording replaces no file")
            require_writable(path)
        self.path = path
        self._begun = False
        self.failure = ""
        """Reason for an early end of the recording; empty while it works."""
        self.dropped = 0
        self._refused: set[str] = set()
        """Topics of which a message could not be written."""
        self._clocks_ns = time.time_ns() - time.monotonic_ns()
        self._queue: queue.Queue[Recorded | None] = queue.Queue(QUEUE_LENGTH)
        self._thread: threading.Thread | None = None

    def open(self, attachments: Mapping[str, bytes]) -> None:
        """Make the file with its attachments. Raises FileError."""
        if self.path is None:
            return
        try:
            writer = RecordingWriter(self.path)
            for name, content in attachments.items():
                writer.attach(name, content)
            writer.flush()  # the thread syncs
        except OSError as error:
            raise FileError(f"{self.path}: cannot be written: {error.strerror}") from error
        self._thread = threading.Thread(target=self._run, args=(writer,), name="recorder", daemon=True)
        self._thread.start()

    def begin(self) -> None:
        """Keep the recording from the next message on: the drive begins."""
        self._begun = True

    def put(self, message: Recorded) -> None:
        """Hand over a message; never waits. Its log time is kept free of settings of the wall clock."""
        if self.path is None:
            return
        wall_ns = time.time_ns()
        set_ns = wall_ns - time.monotonic_ns() - self._clocks_ns
        if abs(wall_ns - message.log_ns) < STAMPED_NS:
            message = replace(message, log_ns=message.log_ns - set_ns)
        if message.topic in SHOWN and self._queue.qsize() >= BEHIND:
            self.dropped += 1
            return
        try:
            self._queue.put_nowait(message)
        except queue.Full:
            self.dropped += 1

    def close(self) -> None:
        """Write what is still queued and finish the file, if it was opened; without a drive remove it.

        A file that cannot be removed stays.
        """
        if self._thread is None:
            return
        try:
            self._queue.put(None, timeout=CLOSE_TIMEOUT_S)
        except queue.Full:
            self.failure = self.failure or "the disk did not keep up"
        self._thread.join(CLOSE_TIMEOUT_S)
        if self._thread.is_alive():
            self.failure = self.failure or "the disk did not answer"
        if not self._begun and self.path is not None:
            with contextlib.suppress(OSError):
                self.path.unlink()
            self.path = None

    @property
    def fields(self) -> dict[str, Any]:
        """The fields of a `RecordingResult`."""
        return {
            "recording": str(self.path) if self.path else None,
            "recording_failure": self.failure or None,
        }

    def _run(self, writer: RecordingWriter) -> None:
        closing = False
        try:
            self._write_until_closed(writer)
            closing = True
            writer.close()
        except Exception as error:  # a recorder that fails, however it fails, must not end the drive
            self.failure = f"{self.path}: {error}"
            writer.abandon()
            while not closing and self._queue.get() is not None:
                self.dropped += 1

    def _write_until_closed(self, writer: RecordingWriter) -> None:
        flushed = time.monotonic()
        while True:
            try:
                message = self._queue.get(timeout=max(0.0, flushed + FLUSH_S - time.monotonic()))
                if message is None:
                    return
                self._write(writer, message)
            except queue.Empty:
                pass
            if time.monotonic() >= flushed + FLUSH_S:
                writer.sync()
                flushed = time.monotonic()

    def _write(self, writer: RecordingWriter, message: Recorded) -> None:
        try:
            writer.write(message)
        except ValueError as error:
            self.dropped += 1
            if message.topic not in self._refused:
                self._refused.add(message.topic)
                _log.warning("%s lacks messages: %s", self.path, error)
