"""Ctrl-C and the other signals that end a command. Imports almost nothing, so that it can come first."""

import signal
import sys
from types import FrameType

TYPE_CHECKING = False
if TYPE_CHECKING:  # without the import of typing
    from sys import UnraisableHookArgs

INTERRUPTED = 130
"""Exit code of a command that was interrupted."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_AGAIN_S = 0.01
_DROPPING = (
    "importlib._bootstrap.",  # an import that fails half-way can leave a library useless
    "_frozen_importlib.",  # the same module, before importlib is imported
    "llvmlite.",
    "pymunk._callbacks.",
    "pydantic.",
    "enum.",  # numpy looks for attributes of an enumeration before it compares an array with a member
)
"""Modules, a dot after each name, whose caller is compiled code that drops or replaces exceptions."""


class Interruption:
    """Whether this process was interrupted."""

    raised = False


def is_interruption(error: BaseException) -> bool:
    """Return whether an interruption caused an exception.

    Code that it interrupts may raise another one, such as a ``threading.Condition`` that lost its lock.
    """
    return isinstance(error, KeyboardInterrupt) or Interruption.raised


def interrupt(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt; as long as a module runs in which it is lost, later."""
    while frame is not None:
        if f"{frame.f_globals.get('__name__')}.".startswith(_DROPPING):
            _interrupt_later(number)
            return
        frame = frame.f_back
    Interruption.raised = True
    raise KeyboardInterrupt


def handle_signals() -> None:
    """Raise KeyboardInterrupt at each signal that ends a command.

    A signal that was ignored before stays ignored: SIGINT in a shell's background, SIGHUP under ``nohup``.
    """
    sys.unraisablehook = _raise_again
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, interrupt)


def ignore_signals() -> None:
    """Ignore these signals from now on; for the end of a process, whose exit code is known."""
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _interrupt_later(number: int) -> None:
    signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(number))
    signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)


def _raise_again(dropped: "UnraisableHookArgs") -> None:
    """Repeat an interruption that was raised where Python has to drop it, such as in ``__del__``."""
    if dropped.exc_type is KeyboardInterrupt:
        _interrupt_later(signal.SIGINT)
    else:
        sys.__unraisablehook__(dropped)
