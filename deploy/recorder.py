"""Recording beside the drive: a thread of its own, so that no disk ever holds up the control loop.

Messages are handed over through a bounded queue; one that finds it full is counted as dropped. When the
disk fails, recording ends, `Recorder.failure` gives the reason, and the drive goes on; the file so far stays
readable. A killed process loses at most the messages after the last flush.
"""

import queue
import threading
import time
from collections.abc import Mapping
from pathlib import Path

from rover_ncp.core.errors import FileError
from rover_ncp.core.recording import Recorded, RecordingWriter

FLUSH_S = 0.4
"""Leaves a tenth of a second for the queue and the disk: a killed process loses at most 0.5 s."""
QUEUE_LENGTH = 10_000
"""A minute of everything the bridge publishes."""
CLOSE_TIMEOUT_S = 10.0


class Recorder:
    """Writes one recording. Opening it may raise FileError; from then on nothing raises."""

    def __init__(self, path: Path, attachments: Mapping[str, bytes], *, overwrite: bool = False) -> None:
        self.path = path
        self.failure = ""
        """Reason for an early end of the recording; empty while it works."""
        self.written = 0
        self.dropped = 0
        self._queue: queue.Queue[Recorded | None] = queue.Queue(QUEUE_LENGTH)
        try:
            self._writer = RecordingWriter(path, overwrite=overwrite)
            for name, content in attachments.items():
                self._writer.attach(name, content)
            self._writer.flush()
        except OSError as error:
            raise FileError(f"{path}: cannot be written: {error.strerror}") from error
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def put(self, message: Recorded) -> None:
        """Hand over a message; never waits."""
        try:
            self._queue.put_nowait(message)
        except queue.Full:
            self.dropped += 1

    def close(self) -> None:
        """Write what is still queued and finish the file."""
        try:
            self._queue.put(None, timeout=CLOSE_TIMEOUT_S)
        except queue.Full:
            self.failure = self.failure or "the disk did not keep up"
        self._thread.join(CLOSE_TIMEOUT_S)
        if self._thread.is_alive():
            self.failure = self.failure or "the disk did not answer"

    def _run(self) -> None:
        closing = False
        try:
            self._write_until_closed()
            closing = True
            self._writer.close()
        except Exception as error:  # a recorder that fails, however it fails, must not end the drive
            self.failure = f"{self.path}: {error}"
            self._writer.abandon()
            while not closing and self._queue.get() is not None:
                self.dropped += 1

    def _write_until_closed(self) -> None:
        flushed = time.monotonic()
        while True:
            try:
                message = self._queue.get(timeout=max(0.0, flushed + FLUSH_S - time.monotonic()))
                if message is None:
                    return
                self._writer.write(message)
                self.written += 1
            except queue.Empty:
                pass
            if time.monotonic() >= flushed + FLUSH_S:
                self._writer.flush()
                flushed = time.monotonic()
