"""The paper's claims (``claims.yaml``) and their verdicts, from the stored runs.

Five tests: ``rate`` of successes, ``value`` of a mean, ``compare`` of two agents, ``sign`` of Definition 1,
number of ``parameters``. A claim *holds* only where a test excludes the opposite, or an interval
lies within a stated margin of equality. Holm's correction is for the claims from one place of the paper.

Definition 1 leaves three choices open: whether vertical steps count (the supplement calls them independence),
whether the whole run counts or only the drive, and the threshold. A sign here is one that all choices give.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from paper.statistics import LEVEL, Summary, even_odds, fisher, holm, mean_text, summary, welch, wilson
from paper.store import ResultStore
from paper.tasks import TASKS, Net, Vector
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.config import StrictModel, parse_yaml
from rover_ncp.core.files import read_text
from rover_ncp.course.course import load_course
from rover_ncp.neurons.interpretation import STILL_MV, Sign, sign_of, time_constant_ranges
from sim.learn.rollout import Rollout, rollout

CLAIMS = Path(__file__).parent / "claims.yaml"
MIN_RUNS = 5
"""Fewer runs of an agent give no verdict."""
MIN_CLEAR = 6
"""With fewer clear signs the sign test cannot reach the level."""
RATE_MARGIN = 0.2
"""Difference of success rates that counts as none."""


class Verdict(StrEnum):
    """Result of a claim's test."""

    HOLDS = "holds"
    DIFFERS = "does not hold"
    UNDECIDED = "undecided"
    NOT_TESTED = "not tested"


class Claim(StrictModel):
    """A claim of the paper and the test that decides on it."""

    name: str
    words: str
    where: str
    test: Literal["rate", "value", "compare", "sign", "parameters"] | None = None
    """None: nothing in this project can test it."""
    arguments: dict[str, Any] = Field(default_factory=dict)
    comparable: bool = True
    """Whether the test decides. Figures of other things than the paper's, or true by construction, do not."""
    why: str = ""
    """Reason that a claim is not tested, or a deviation from the paper."""


class ClaimsFile(StrictModel):
    """``claims.yaml``: the page's questions, each with the claims that answer it, and all claims."""

    questions: dict[str, tuple[str, ...]]
    claims: tuple[Claim, ...]

    def of(self, test: str) -> list[Claim]:
        """Return the claims that a test decides on."""
        return [claim for claim in self.claims if claim.test == test]


@dataclass(frozen=True)
class Finding:
    """Result of a test before Holm's correction."""

    figure: str = ""
    against: str = ""
    """What the figure is compared with."""
    verdict: Verdict | None = None
    """None: p decides."""
    why: str = ""
    """Reason of a verdict that is open, or the numbers of runs behind p."""
    p: float | None = None
    significant: Verdict = Verdict.DIFFERS
    """What a significant p means."""


class Judged(NamedTuple):
    """A claim with its verdict."""

    name: str
    words: str
    where: str
    verdict: Verdict
    figure: str
    against: str
    why: str


def load_claims() -> ClaimsFile:
    """Return the claims."""
    return parse_yaml(read_text(CLAIMS), ClaimsFile, str(CLAIMS))


def judge_claims(store: ResultStore, claims: Sequence[Claim]) -> list[Judged]:
    """Return the verdicts on claims. Raises FileError."""
    findings = [
        _TESTS[claim.test](store, **claim.arguments) if claim.test else Finding(verdict=Verdict.NOT_TESTED)
        for claim in claims
    ]
    for number, claim in enumerate(claims):
        if not claim.comparable:
            findings[number] = replace(findings[number], verdict=Verdict.NOT_TESTED, p=None)
    places: dict[tuple[str, str | None], dict[int, float]] = {}
    for number, (claim, finding) in enumerate(zip(claims, findings, strict=True)):
        if finding.p is not None:
            places.setdefault((claim.where, claim.test), {})[number] = finding.p
    for found in places.values():
        for number, p in zip(found, holm(list(found.values())), strict=True):
            findings[number] = replace(findings[number], p=p)
    return [_judged(claim, finding) for claim, finding in zip(claims, findings, strict=True)]


def _judged(claim: Claim, finding: Finding) -> Judged:
    verdict, why = finding.verdict, claim.why
    if verdict is None:
        assert finding.p is not None
        verdict = finding.significant if finding.p < LEVEL else Verdict.UNDECIDED
    if verdict is Verdict.UNDECIDED:
        why = finding.why if finding.p is None else f"p = {finding.p:.2g}, {finding.why}"
    elif verdict is Verdict.NOT_TESTED:
        why = claim.why or finding.why
    from_paper = finding.against and claim.test != "compare"
    against = f"{claim.where}: {finding.against}" if from_paper else finding.against
    return Judged(claim.name, claim.words, claim.where, verdict, finding.figure, against, why)


def _too_few(count: int) -> Finding:
    return Finding(
        verdict=Verdict.NOT_TESTED, why=f"{count} runs, {MIN_RUNS} are needed" if count else "no runs"
    )


def rate(
    store: ResultStore, *, task: str, hits: int, of: int, budget: str = "published", within: int | None = None
) -> Finding:
    """Compare the circuit's success rate with another one.

    ``within`` counts runs that end as successes and reached the task's return after so many iterations.
    """
    runs = store.results(task, "circuit", budget)
    if len(runs) < MIN_RUNS:
        return _too_few(len(runs))
    succeeded = [run.success for run in runs]
    if within is not None:
        succeeded = [run.success and run.value_after(within) >= TASKS[task].success for run in runs]
    count = sum(succeeded)
    found, (low, high) = fisher(count, len(runs), hits, of), wilson(count, len(runs))
    figure = f"{count} of {len(runs)} [{low:.0%}, {high:.0%}]"
    verdict = Verdict.HOLDS if found.within(RATE_MARGIN) else None
    return Finding(figure, f"{hits} of {of}", verdict, f"n = {len(runs)} and {of}", found.p)


def value(
    store: ResultStore,
    *,
    task: str,
    agent: str,
    mean: float,
    std: float,
    of: int = 10,
    rate: float | None = None,
    budget: str = "published",
) -> Finding:
    """Compare mean and standard deviation of returns with the paper's.

    ``rate`` is what the paper's table says beside them.
    """
    returns = store.returns(task, agent, budget)
    if len(returns) < MIN_RUNS:
        return _too_few(len(returns))
    ours = summary(returns)
    found = welch(ours, Summary(mean, std, of))
    verdict = Verdict.HOLDS if found.within(TASKS[task].margin) else None
    texts = mean_text(ours.mean, ours.std), mean_text(mean, std)
    return Finding(*texts, verdict, f"n = {ours.runs} and {of}", found.p)


def compare(
    store: ResultStore,
    *,
    task: str,
    other: str,
    budget: str = "published",
    other_budget: str | None = None,
    better: bool = False,
) -> Finding:
    """Compare the circuit's returns with another agent's: ``better``, or not worse by the task's margin."""
    ours, theirs = store.returns(task, "circuit", budget), store.returns(task, other, other_budget or budget)
    if min(len(ours), len(theirs)) < MIN_RUNS:
        return _too_few(min(len(ours), len(theirs)))
    found = welch(summary(ours), summary(theirs))
    margin = 0.0 if better else TASKS[task].margin
    on_par = welch(summary(ours + margin), summary(theirs))
    reproduced = on_par.value > 0.0  # else p is of the opposite; each p is of both tails
    return Finding(
        f"{mean_text(float(ours.mean()))} against {mean_text(float(theirs.mean()))}",
        f"difference {found.text()}",
        None,
        f"n = {len(ours)} and {len(theirs)}",
        on_par.p if reproduced else found.p,
        Verdict.HOLDS if reproduced else Verdict.DIFFERS,
    )


def sign(store: ResultStore, *, source: str, destination: str, expected: str) -> Finding:
    """Ask whether most of the circuits in which all readings agree have the paper's sign (sign test)."""
    found = [readings(policy, drive, source, destination) for policy, drive in drives(store)]
    if len(found) < MIN_RUNS:
        return _too_few(len(found))
    clear = clear_signs(found)
    hits, count = sum(each == expected for each in clear), len(clear)
    figure = f"{hits} of {count}, {len(found) - count} unclear"
    if count < MIN_CLEAR:
        why = f"{count} clear, {MIN_CLEAR} needed"
        return Finding(figure, verdict=Verdict.NOT_TESTED, why=why)
    significant = Verdict.HOLDS if 2 * hits > count else Verdict.DIFFERS
    return Finding(figure, "", None, f"n = {count}", even_odds(hits, count), significant)


def parameters(_: ResultStore, *, task: str, other: str) -> Finding:
    """Ask whether the circuit has fewer parameters than a network of as many cells."""
    circuit = TASKS[task].policy(TASKS[task].circuit())
    net = Net(other, len(circuit.sensing.inputs), len(circuit.motors.outputs), cells=11)
    ours, theirs = circuit.layout().size, net.layout().size
    verdict = Verdict.HOLDS if ours < theirs else Verdict.DIFFERS
    return Finding(f"{ours} against {theirs}", verdict=verdict)


_TESTS: Mapping[str, Callable[..., Finding]] = {
    "rate": rate,
    "value": value,
    "compare": compare,
    "sign": sign,
    "parameters": parameters,
}


THRESHOLDS = (1.0, 1.5, 2.0)
"""One count must exceed the other by this factor; the paper's words allow several readings."""
_MOVING = 1e-4
"""Distance in m, or turn in rad, in a tick of 0.1 s above which the rover drives."""


@lru_cache(maxsize=1)
def drives(store: ResultStore) -> tuple[tuple[Policy, Rollout], ...]:
    """Return the published search's parking circuits that succeed, the best first, each with its drive."""
    results = [result for result in store.results("parking", "circuit") if result.success]
    results.sort(key=lambda result: -result.mean)
    untrained = TASKS["parking"].policy(TASKS["parking"].circuit())
    policies = [untrained.with_parameters(result.parameters.array()) for result in results]
    return tuple((policy, rollout(policy, load_course("parking"))) for policy in policies)


def counts(a: Vector, b: Vector, *, vertical: bool) -> tuple[int, int]:
    """Return P and Q of two rows of potential differences: slopes above and below 0.

    A vertical step (b changes, a does not) has the sign of b's change; without ``vertical`` it is left out.
    """
    a, b = (np.where(np.abs(each) <= STILL_MV, 0.0, each) for each in (a, b))
    slopes = np.where((a == 0.0) & vertical, b, a * b)
    return int(np.sum(slopes > 0.0)), int(np.sum(slopes < 0.0))


def readings(policy: Policy, drive: Rollout, source: str, destination: str) -> Counter[Sign]:
    """Return the signs that the twelve readings of Definition 1 give a pair of neurons."""
    steps = np.diff(drive.potentials, axis=0)
    a, b = (steps[:, policy.circuit.index(neuron)] for neuron in (source, destination))
    moved = np.abs(np.diff(drive.poses, axis=0))[1:].max(axis=1) > _MOVING
    found: Counter[Sign] = Counter()
    for part, vertical in product((moved, np.ones_like(moved)), (True, False)):
        positive, negative = counts(a[part], b[part], vertical=vertical)
        found.update(sign_of(positive, negative, threshold) for threshold in THRESHOLDS)
    return found


def clear_signs(found: Iterable[Counter[Sign]]) -> list[Sign]:
    """Return the sign of each circuit's ``readings`` where all of them give the same one."""
    signs = [next(iter(each)) for each in found if len(each) == 1]
    return [sign for sign in signs if sign is not Sign.NONE]


def time_constants(store: ResultStore) -> dict[str, tuple[float, float]]:
    """Return the time constants in s of the best parking circuit over its drive, by neuron."""
    for policy, drive in drives(store)[:1]:
        ranges = time_constant_ranges(policy.circuit, drive.potentials, policy.sensing.neurons)
        return {each.neuron: (each.lowest_s, each.highest_s) for each in ranges}
    return {}
