"""Questions to a person: each says why it is asked, and has a default."""

from collections.abc import Callable, Sequence


class Dialog:
    """``ask`` shows a prompt and returns the line that was typed; ``say`` shows a line."""

    def __init__(self, ask: Callable[[str], str], say: Callable[[str], None]) -> None:
        self._ask, self.say = ask, say

    def text(self, question: str, why: str, default: str | None) -> str | None:
        """Return an answer; an empty one is the default, and ``-`` is None."""
        self._explain(question, why)
        answer = self._ask(f"  [{default if default is not None else 'none'}] ").strip()
        return default if not answer else None if answer == "-" else answer

    def yes(self, question: str, why: str, *, default: bool = False) -> bool:
        """Return whether a person agrees."""
        self._explain(question, why)
        while True:
            answer = self._ask(f"  [{'Y/n' if default else 'y/N'}] ").strip().lower()
            if answer in {"", "y", "yes", "n", "no"}:
                return default if not answer else answer[0] == "y"
            self.say("  expected y or n")

    def choice(
        self, question: str, why: str, options: Sequence[str], other: str, default: str | None
    ) -> str | None:
        """Return one of the options, by its number, or another text; ``other`` says what that is."""
        listed = [*options, *([default] if default is not None and default not in options else [])]
        self._explain(question, why)
        for number, option in enumerate(listed, 1):
            self.say(f"  {number}  {option}")
        first = default if default is not None else listed[0] if listed else None
        while True:
            answer = self._ask(f"  number, {other}, or - for none [{first or 'none'}] ").strip()
            if not answer:
                return first
            if answer == "-":
                return None
            if not answer.isdecimal():
                return answer
            if 1 <= int(answer) <= len(listed):
                return listed[int(answer) - 1]
            self.say(f"  expected a number from 1 to {len(listed)}")

    def _explain(self, question: str, why: str) -> None:
        for line in ("", question, f"  {why}"):
            self.say(line)
