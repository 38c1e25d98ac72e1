"""When a process that ended is started again. Pure."""

MIN_WAIT_S, MAX_WAIT_S = 1.0, 30.0
"""The wait before a restart doubles from the first to the second."""
STEADY_S = 60.0
"""A process that ran for so long begins with the shortest wait again."""


class Restarts:
    """Counts the restarts of one process, and spaces them."""

    def __init__(self) -> None:
        self.count = 0
        self._wait_s, self._due_s = MIN_WAIT_S, 0.0

    def ended(self, now_s: float, began_s: float) -> float:
        """Note the end of a process that began at a time; return the wait before its restart, s."""
        if now_s - began_s >= STEADY_S:
            self._wait_s = MIN_WAIT_S
        wait_s, self._wait_s = self._wait_s, min(2.0 * self._wait_s, MAX_WAIT_S)
        self._due_s = now_s + wait_s
        return wait_s

    def due(self, now_s: float) -> bool:
        """Whether the process may start again."""
        return now_s >= self._due_s

    def started(self) -> None:
        """Count a restart."""
        self.count += 1
