"""A gate with its state, a driver's clock that differs from the bridge's, and timelines that both follow.

Digests are verified before the gate: here a command or a request says whether it is signed by the holder.
The format of timelines is described in tests/data/gate_timelines.txt.
"""

import itertools
import math
import re
from dataclasses import replace
from typing import NamedTuple

import pytest

from bridge.base import BaseReport
from bridge.gate.gate import step
from bridge.gate.limits import Fence, Limits
from bridge.gate.state import BaseLost, Enable, GateState, Release, ReleaseStop, Stop, Tick, VelocityCommand
from kit.paths import DATA
from rover_ncp.core.geometry import STANDSTILL, Velocity
from rover_ncp.wire.protocol import CommandTag

SECRET = bytes(range(32))
SLOW = Velocity(0.1, -0.1)
LIMITS = Limits()
TIMELINES = DATA / "gate_timelines.txt"
NUMBERS = frozenset({"nan", "inf"})
BOX = Fence(x_min=-1.0, x_max=2.0, y_min=-1.0, y_max=1.0)


class Gate:
    """A gate with its state. Times are the bridge's; the driver's clock differs by ``ahead_s``."""

    def __init__(self, limits=LIMITS, ahead_s=1234.5):
        self.state, self.limits, self.ahead_s = GateState(), limits, ahead_s
        self.sequence = 0
        self.report = None
        """The base repeats this report, if there is one, before each command and request."""

    def at(self, now, event):
        if self.report is not None and isinstance(event, Enable | VelocityCommand):
            self.state, _ = step(self.state, self.report, now, self.limits)
        self.state, verdict = step(self.state, event, now, self.limits)
        return verdict

    def place(self, now, base):
        """Report a base that has driven to its pose since the last report."""
        self.state = replace(self.state, base=BaseReport(base.x, base.y, base.theta))
        return self.at(now, base)

    def stamp(self, now):
        return round((now + self.ahead_s) * 1e9)

    def _numbered(self, sequence):
        """Return a given number, or the next one."""
        if sequence is None:
            self.sequence += 1
            return self.sequence
        return sequence

    def drive(self, now, velocity=SLOW, signed=True, age=0.0, sequence=None, shift_ns=0):
        """A command that was sent ``age`` seconds and ``shift_ns`` before it arrives at ``now``."""
        tag = CommandTag(1, self._numbered(sequence), self.stamp(now - age) - shift_ns)
        return self.at(now, VelocityCommand(velocity, tag, signed=signed))

    def enable(self, now, secret=SECRET, age=0.0):
        """A request for the motors by a new driver."""
        return self.at(now, Enable("deploy", self.stamp(now - age), secret))

    def renew(self, now, sequence=None, secret=SECRET):
        """A signed request of the driver that holds the lease."""
        return self.at(now, Enable("deploy", self.stamp(now), secret, self._numbered(sequence)))

    def release(self, now, sequence=None):
        """A signed release."""
        return self.at(now, Release(self._numbered(sequence)))

    def driving(self, now=0.0):
        """Bring the gate to where a command is in force since ``now``, at full size."""
        self.at(now - 0.3, BaseReport(motors_on=False))
        assert self.enable(now - 0.3).refusal is None
        self.at(now - 0.2, BaseReport())
        for k in (2, 1, 0):
            verdict = self.drive(now - 0.05 * k)
        self.at(now, BaseReport())
        assert verdict.velocity == SLOW
        return self


class Timeline(NamedTuple):
    """A gate's options, and rows of (times, events, whether each verdict is expected, expectation)."""

    start: list[str]
    rows: list[tuple[list[float], list[list[str]], bool, list[str]]]


def timelines():
    """Return all timelines as parameters of a test."""
    for block in TIMELINES.read_text().split("\n## ")[1:]:
        title, *lines = [line for line in block.splitlines() if line.strip() and not line.startswith("# ")]
        loops = [line[4:].partition(":") for line in lines if line.startswith("for ")]
        body = [line for line in lines if not line.startswith("for ")]
        choices = [[row.split() for row in values.split("|")] for _, _, values in loops]
        names = [name for words, _, _ in loops for name in words.split()]
        for row in itertools.product(*choices):
            values = list(itertools.chain(*row))
            text = "\n".join(body)
            for name, value in sorted(zip(names, values, strict=True), reverse=True):
                text = text.replace(name, value)
            start, *rows = text.splitlines()
            label = " ".join([title, *values]).replace(" ", "_")
            yield pytest.param(Timeline(start.split(), [_row(line) for line in rows]), id=label)


def follow(timeline):
    """Drive a gate along a timeline and compare each verdict with the expected one."""
    settings = dict(word.partition("=")[::2] for word in timeline.start)
    gate = Gate(_limits(settings), _number(settings.get("ahead", "1234.5")))
    if "driving" in settings:
        gate.driving(_number(settings["driving"] or "0"))
    for times, events, each, expected in timeline.rows:
        for now in times:
            for event in events:
                verdict = _happen(gate, now, *event)
            if each or now == times[-1]:
                for word in expected:
                    found, wanted = _found(gate, verdict, word)
                    assert found == wanted, f"at {now}: {word}, but it is {found}"


def _row(line):
    what, _, expected = line.partition("|")
    when, *events = what.split(maxsplit=1)
    words = expected.split()
    parsed = [re.split(r"[,\s]+", event.strip()) for event in events[0].split(";")]
    return _times(when), parsed, "each" in words, [word for word in words if word != "each"]


def _times(text):
    begin, dots, rest = text.partition("..")
    if not dots:
        towards = {"+": math.inf, "-": -math.inf}.get(text[-1])
        return [float(text) if towards is None else math.nextafter(float(text[:-1]), towards)]
    end, _, step_s = rest.partition("/")
    count = round((float(end) - float(begin)) / float(step_s)) + 1
    return [round(float(begin) + k * float(step_s), 9) for k in range(count)]


def _number(text, now=0.0):
    return float(eval(text, {"pi": math.pi, "nan": math.nan, "inf": math.inf, "t": now}))


def _limits(settings):
    named = {
        name: _number(value) for name, value in settings.items() if name in Limits.model_fields and value
    }
    return LIMITS.model_copy(update={**named, "fence": BOX if "fence" in settings else None})


def _report(settings, now):
    values = {}
    for name, value in settings.items():
        if name in ("bumpers", "stalled"):
            kind = int if name == "bumpers" else lambda bit: bit == "1"
            values[name] = tuple(map(kind, value.split("/")))
        elif name == "motors_off":
            values["motors_on"] = False
        else:
            values[name] = _number(value, now) if value else True
    return BaseReport(**values)


def _happen(gate, now, kind, *words):
    options = dict(word.partition("=")[::2] for word in words if word[0].isalpha() and word not in NUMBERS)
    numbers = [_number(word) for word in words if word in NUMBERS or not word[0].isalpha()]
    velocity = None if "unreadable" in options else Velocity(*numbers) if len(numbers) == 2 else SLOW
    age = {"age": _number(options["age"])} if "age" in options else {}
    number = {"sequence": int(options["sequence"])} if "sequence" in options else {}
    secret = {"secret": bytes(32)} if "other_secret" in options else {}
    if kind == "drive":
        signed, shift_ns = "unsigned" not in options, int("earlier" in options)
        return gate.drive(now, velocity, signed, **age, **number, shift_ns=shift_ns)
    if kind in ("enable", "renew", "release"):
        return getattr(gate, kind)(now, **number, **secret)
    if kind == "place":
        return gate.place(now, _report(options, now))
    if kind in ("ahead", "limits"):
        gate.ahead_s += sum(numbers)
        gate.limits = _limits(options) if kind == "limits" else gate.limits
        return None
    if kind == "keep":
        gate.report = _report(options, now)
    events = {
        "report": lambda: _report(options, now),
        "keep": lambda: gate.report,
        "lost": lambda: BaseLost(restarted="restarted" in options),
        "stop": lambda: Stop(" ".join(words)),
        "unstop": ReleaseStop,
    }
    return gate.at(now, events.get(kind, Tick)())


def _found(gate, verdict, word):
    """Return what a word of an expectation asks for, and what it expects."""
    state, (name, _, wanted) = gate.state, word.partition("=")
    lease = verdict.lease
    secret = lease and lease.secret
    counts = {"stops": state.stops, "drops": state.dropped, "limited": state.limited}
    if name in counts:
        found = ",".join(f"{reason}:{count}" for reason, count in counts[name].items())
        return found or "none", wanted
    if name.startswith(("(", "~(")):
        velocity = Velocity(*map(_number, name.lstrip("~").strip("()").split(",")))
        return verdict.velocity, pytest.approx(velocity, abs=1e-9) if name[0] == "~" else velocity
    if name in ("zero", "moves"):
        return verdict.velocity == STANDSTILL, name == "zero"
    found = {
        "held": verdict.held,
        "dropped": verdict.dropped,
        "refused": verdict.refusal,
        "over": state.lease_over,
        "motors": "on" if verdict.motors else "off",
        "emergency": "yes" if verdict.emergency else "no",
        "lease": None if lease is None else lease.number,
        "secret": secret and ("first" if secret == SECRET else "other"),
        "accepted": state.accepted,
        "stopped": state.stop_reason,
    }[name]
    return "none" if found is None else str(found), wanted
