"""At most one ``up`` for each robot on this machine: a name that the system frees at the holder's end."""

import os
import socket
import struct
import sys
from contextlib import suppress
from pathlib import Path

from rover_ncp.core.errors import PortInUse
from rover_ncp.core.process import ClosedAtExit

_CREDENTIALS = struct.Struct("3i")


class RobotLock(ClosedAtExit):
    """Holds a base's address. Raises PortInUse that names the process that holds it.

    The name is an abstract Unix socket, which only Linux has; elsewhere nothing is held, and the second
    bridge finds its port or its serial line in use.
    """

    def __init__(self, base: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        if sys.platform != "linux":
            return
        name = f"\0rover-ncp up {_same_device(base)}"[:100]
        try:
            self._socket.bind(name)
            self._socket.listen()
        except OSError as error:
            holder = _holder(name)
            self._socket.close()
            raise PortInUse(f"'rover-ncp up' runs already for {base}: {holder}") from error

    def close(self) -> None:
        """Free the address."""
        self._socket.close()


def _same_device(base: str) -> str:
    """Return one name for all links to a serial device."""
    kind, _, path = base.partition("#")[0].partition("/")
    return os.path.realpath(path) if kind == "serial" else base


def _holder(name: str) -> str:
    with suppress(OSError), socket.socket(socket.AF_UNIX) as client:
        client.settimeout(1.0)
        client.connect(name)
        found = client.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        pid = _CREDENTIALS.unpack(found)[0]
        with suppress(OSError):
            return f"process {pid} in {Path(f'/proc/{pid}/cwd').readlink()}"
        return f"process {pid}"
    return "its process is not known"
