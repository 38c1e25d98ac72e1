"""What commands say: one JSON object on stdout with ``--json``, otherwise text for people.

Everything meant for people goes to stderr under ``--json``, so that stdout stays machine-readable.
"""

import json
import math
import sys
from collections.abc import Mapping
from typing import Any

from rich.console import Console

__all__ = ["Output"]


class Output:
    """The two channels of a command."""

    ended = False
    """Whether a command of this process has given its result: then nobody else is to give one for it."""

    def __init__(self, as_json: bool) -> None:
        self.as_json = as_json
        self.console = Console(stderr=as_json, highlight=False, soft_wrap=True)

    def say(self, text: str) -> None:
        """Print a line for people."""
        self.console.print(text, markup=False)

    def result(self, fields: Mapping[str, Any], text: str) -> None:
        """End a command: the fields as JSON, or the text, whichever was asked for."""
        Output.ended = True
        if self.as_json:
            sys.stdout.write(json.dumps(_plain(fields), allow_nan=False) + "\n")
            sys.stdout.flush()
        else:
            self.say(text)


def _plain(value: Any) -> Any:
    """Turn numpy values into JSON's own; a number that is not finite becomes null, as JSON has none."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if value is None or isinstance(value, str | int | float | bool):
        return value
    return str(value)
