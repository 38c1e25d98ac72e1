"""The paper's claims (``claims.yaml``) and their verdicts, from the stored runs.

A test is a function of its name below. A claim *holds* only where it excludes the opposite, or an interval
lies within a stated margin of equality. Holm's correction is for the claims from one place of the paper.

Definition 1 leaves three choices open: whether vertical steps count (the supplement calls them independence),
whether the whole run counts or only the drive, and the threshold. Claims are judged by one reading: the whole
run with vertical steps, and P > 1.5 Q. ``readings`` has all twelve.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from itertools import chain, product
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field
from scipy.stats import binomtest

from paper.runs import PAIRS
from paper.statistics import LEVEL, fisher, holm, mean_text, welch, wilson
from paper.store import BudgetName, Result, ResultStore
from paper.tasks import TASKS, Net, Vector
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.config import StrictModel, load_yaml
from rover_ncp.course.course import load_course
from rover_ncp.neurons.interpretation import STILL_MV, Sign, sign_of, time_constant_ranges
from sim.learn.rollout import Rollout, rollout
from sim.learn.search.algorithm1 import ALPHA, SIGMA

MIN_RUNS = 5
"""Fewer runs of an agent give no verdict."""
RATE_MARGIN = 0.2
"""Difference of success rates that counts as none."""


class Verdict(StrEnum):
    """Result of a claim's test."""

    HOLDS = "holds"
    DIFFERS = "does not hold"
    UNDECIDED = "undecided"
    NOT_COMPARABLE = "not comparable"
    NOT_TESTED = "not tested"


class Claim(StrictModel):
    """A claim of the paper and the test that decides on it."""

    words: str
    label: str = ""
    """Its words in the short answer to a question, where they are others."""
    where: str
    test: str
    arguments: dict[str, Any] = Field(default_factory=dict)
    why: str = ""
    """Reason that the paper's figure is of another thing, so that no test decides."""
    core_h: float = 0.1
    """Core hours of a run, measured."""


class ClaimsFile(StrictModel):
    """``claims.yaml``: the page's questions with the claims that answer them, and the paper's tables."""

    questions: dict[str, tuple[Claim, ...]]
    tables: dict[str, dict[str, dict[str, tuple[float, ...]]]]
    """Mean, standard deviation and success rate, where there is one, by table, task and agent."""
    literature: tuple[tuple[str, str], ...]
    """Results of PPO on the half-cheetah that others have published, and their sources."""


FILE = load_yaml(Path(__file__).with_suffix(".yaml"), ClaimsFile)
CLAIMS = tuple(chain.from_iterable(FILE.questions.values()))


@dataclass
class Finding:
    """Result of a test."""

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
    missing: int = 0
    """Runs that a verdict needs beside the stored ones."""


def judge_claims(store: ResultStore, claims: Sequence[Claim] = CLAIMS) -> list[Finding]:
    """Return what the runs say on claims, each with a verdict. Raises FileError."""
    findings = [_TESTS[claim.test](store, **claim.arguments) for claim in claims]
    places: dict[tuple[str, str], list[Finding]] = {}
    for claim, finding in zip(claims, findings, strict=True):
        if claim.why and finding.verdict is not Verdict.NOT_TESTED:
            finding.verdict, finding.p = Verdict.NOT_COMPARABLE, None
        if finding.p is not None:
            places.setdefault((claim.where, claim.test), []).append(finding)
    for found in places.values():
        for finding, p in zip(found, holm([finding.p or 0.0 for finding in found]), strict=True):
            finding.p = p
    for claim, finding in zip(claims, findings, strict=True):
        _decide(claim, finding)
    return findings


def _decide(claim: Claim, finding: Finding) -> None:
    """Give a finding its verdict and the reason of one that is open."""
    core_h = f"{finding.missing} runs are missing, about {finding.missing * claim.core_h:.2g} core hours"
    if finding.verdict is None:
        significant = finding.p is not None and finding.p < LEVEL
        finding.verdict = finding.significant if significant else Verdict.UNDECIDED
    if finding.verdict is Verdict.UNDECIDED:
        finding.why = (
            f"{finding.why}; {core_h}" if finding.p is None else f"p = {finding.p:.2g}, {finding.why}"
        )
    else:
        finding.why = {Verdict.NOT_TESTED: core_h, Verdict.NOT_COMPARABLE: claim.why}.get(finding.verdict, "")
    if finding.against and claim.test in ("rate", "algorithm1"):
        finding.against = f"{claim.where}: {finding.against}"


def _too_few(*counts: int) -> Finding | None:
    """Return that a claim is not tested if one of these numbers of runs is too small, None otherwise."""
    missing = sum(max(MIN_RUNS - count, 0) for count in counts)
    return Finding(verdict=Verdict.NOT_TESTED, missing=missing) if missing else None


def rate(
    store: ResultStore, *, task: str, hits: int, of: int, budget: str = "published", within: int | None = None
) -> Finding:
    """Compare the circuit's success rate with another one.

    ``within`` counts runs that end as successes and reached the task's return after so many iterations.
    """
    runs = store.results(task, "circuit", budget)
    if untested := _too_few(len(runs)):
        return untested
    succeeded = [run.success for run in runs]
    if within is not None:
        succeeded = [run.success and run.value_after(within) >= TASKS[task].success for run in runs]
    count = sum(succeeded)
    found, (low, high) = fisher(count, len(runs), hits, of), wilson(count, len(runs))
    figure = f"{count} of {len(runs)} [{low:.0%}, {high:.0%}]"
    verdict = Verdict.HOLDS if found.within(RATE_MARGIN) else None
    return Finding(figure, f"{hits} of {of}", verdict, f"n = {len(runs)} and {of}", found.p)


def compare(store: ResultStore, *, task: str, other: str, better: bool = False) -> Finding:
    """Compare the circuit's returns with another agent's: ``better``, or not worse by the task's margin."""
    runs = (store.results(task, agent) for agent in ("circuit", other))
    ours, theirs = (np.array([run.mean for run in each]) for each in runs)
    if untested := _too_few(len(ours), len(theirs)):
        return untested
    found = welch(ours, theirs)
    margin = 0.0 if better else TASKS[task].margin
    on_par = welch(ours + margin, theirs)
    reproduced = on_par.value > 0.0  # else p is of the opposite; each p is of both tails
    return Finding(
        f"{mean_text(float(ours.mean()))} against {mean_text(float(theirs.mean()))}",
        f"difference {found.text()}",
        None,
        f"n = {len(ours)} and {len(theirs)}",
        on_par.p if reproduced else found.p,
        Verdict.HOLDS if reproduced else Verdict.DIFFERS,
    )


def algorithm1(store: ResultStore, *, task: str, hits: int, of: int) -> Finding:
    """Compare the rates of Algorithm 1, by alpha and sigma, with another one: the largest p decides."""
    found = by_pair(store.results(task, "circuit", BudgetName.ALGORITHM1))
    counts = [(sum(run.success for run in runs), len(runs)) for runs in found.values()] or [(0, 0)]
    successes, total = (sum(column) for column in zip(*counts, strict=True))
    trained = [count for count in counts if count[1] >= MIN_RUNS]
    best, runs = max(trained or counts, key=lambda count: count[0] / max(count[1], 1))
    figure = f"{successes} of {total} runs of {len(found)} settings, the best {best} of {runs}"
    lacks = [max(MIN_RUNS - len(found.get(pair, ())), 0) for pair in PAIRS]
    p = max((fisher(*count, hits, of).p for count in trained), default=0.0)
    if any(lacks) and p < LEVEL:  # else missing runs cannot refute the claim
        whole = f"{lacks.count(0)} of {len(PAIRS)} settings"
        return Finding(figure, f"{hits} of {of}", Verdict.UNDECIDED, whole, missing=sum(lacks))
    return Finding(figure, f"{hits} of {of}", None, f"n = {min(runs for _, runs in trained)} and {of}", p)


def by_pair(runs: Iterable[Result]) -> dict[tuple[float, float], list[Result]]:
    """Return runs of Algorithm 1 by their alpha and first sigma."""
    found: dict[tuple[float, float], list[Result]] = {}
    for run in runs:
        found.setdefault(run.name.setting or (ALPHA, SIGMA), []).append(run)
    return found


def sign(store: ResultStore, *, source: str, destination: str, expected: Sign) -> Finding:
    """Ask whether most circuits of the published search have the paper's sign (sign test)."""
    found = signs(store, BudgetName.PUBLISHED, source, destination)
    if untested := _too_few(len(found)):
        return untested
    hits, own = found.count(expected), signs(store, BudgetName.DEFAULT, source, destination)
    significant = Verdict.HOLDS if 2 * hits > len(found) else Verdict.DIFFERS
    return Finding(
        f"{hits} of {len(found)}",
        f"default search: {own.count(expected)} of {len(own)}",
        None,
        f"n = {len(found)}",
        float(binomtest(hits, len(found)).pvalue),
        significant,
    )


def constants(store: ResultStore, *, ranges: Mapping[str, tuple[float, float]]) -> Finding:
    """Ask whether each neuron's time constants overlap the paper's."""
    if not (ours := time_constants(store)):
        return Finding(verdict=Verdict.NOT_TESTED, missing=1)
    same = sum(ours[neuron][0] <= high and low <= ours[neuron][1] for neuron, (low, high) in ranges.items())
    verdict = Verdict.HOLDS if same == len(ranges) else Verdict.DIFFERS
    return Finding(f"{same} of {len(ranges)} ranges overlap", verdict=verdict)


def varying(store: ResultStore, *, ratio: float) -> Finding:
    """Ask whether most neurons' time constants vary by more than a ratio."""
    if not (ours := time_constants(store).values()):
        return Finding(verdict=Verdict.NOT_TESTED, missing=1)
    count = sum(high > ratio * low for low, high in ours)
    verdict = Verdict.HOLDS if 2 * count > len(ours) else Verdict.DIFFERS
    return Finding(f"{count} of {len(ours)} neurons, by {ratio - 1:.0%} or more", verdict=verdict)


def parameters(_: ResultStore, *, task: str, other: str) -> Finding:
    """Ask whether the circuit has fewer parameters than a network of as many cells."""
    circuit = TASKS[task].policy()
    net = Net(other, len(circuit.sensing.inputs), len(circuit.motors.outputs), cells=11)
    ours, theirs = circuit.layout().size, sum(net.sizes)
    verdict = Verdict.HOLDS if ours < theirs else Verdict.DIFFERS
    return Finding(f"{ours} against {theirs}", verdict=verdict)


_TESTS: Mapping[str, Callable[..., Finding]] = {
    test.__name__: test for test in (rate, algorithm1, compare, sign, constants, varying, parameters)
}


THRESHOLDS = (1.0, 1.5, 2.0)
"""One count must exceed the other by this factor; the paper's words allow several readings."""
MAIN = (True, True, 1.5)
"""The reading that judges claims."""
_MOVING = 1e-4
"""Distance in m, or turn in rad, in a tick of 0.1 s above which the rover drives."""


@lru_cache(maxsize=2)
def drives(store: ResultStore, budget: BudgetName) -> tuple[tuple[Policy, Rollout], ...]:
    """Return a search's parking circuits that succeed, the best first, each with its drive."""
    results = [result for result in store.results("parking", "circuit", budget) if result.success]
    results.sort(key=lambda result: -result.mean)
    untrained = TASKS["parking"].policy()
    policies = [untrained.with_parameters(result.parameters.array()) for result in results]
    return tuple((policy, rollout(policy, load_course("parking"))) for policy in policies)


def signs(store: ResultStore, budget: BudgetName, source: str, destination: str) -> list[Sign]:
    """Return the sign of a pair in each parking circuit of a search, by the reading that judges claims."""
    return [readings(*circuit, source, destination)[MAIN] for circuit in drives(store, budget)]


def counts(a: Vector, b: Vector, *, vertical: bool) -> tuple[int, int]:
    """Return P and Q of two rows of potential differences: slopes above and below 0.

    A vertical step (b changes, a does not) has the sign of b's change; without ``vertical`` it is left out.
    """
    a, b = (np.where(np.abs(each) <= STILL_MV, 0.0, each) for each in (a, b))
    steps = np.where((a == 0.0) & vertical, b, a * b)
    return int(np.sum(steps > 0.0)), int(np.sum(steps < 0.0))


def readings(
    policy: Policy, drive: Rollout, source: str, destination: str
) -> dict[tuple[bool, bool, float], Sign]:
    """Return the signs that the twelve readings of Definition 1 give a pair of neurons.

    A reading: whether the whole run counts, whether vertical steps do, and the threshold.
    """
    steps = np.diff(drive.potentials, axis=0)
    a, b = (steps[:, policy.circuit.index(neuron)] for neuron in (source, destination))
    moved = np.abs(np.diff(drive.poses, axis=0))[1:].max(axis=1) > _MOVING
    found: dict[tuple[bool, bool, float], Sign] = {}
    for whole, vertical in product((False, True), (True, False)):
        count = counts(a[moved | whole], b[moved | whole], vertical=vertical)
        found |= {(whole, vertical, threshold): sign_of(*count, threshold) for threshold in THRESHOLDS}
    return found


def clear_signs(store: ResultStore, budget: BudgetName, source: str, destination: str) -> list[Sign]:
    """Return the sign of a pair in each parking circuit of a search where all readings give the same one."""
    found = [{*readings(*circuit, source, destination).values()} for circuit in drives(store, budget)]
    return [sign for signs in found for sign in signs if len(signs) == 1 and sign is not Sign.NONE]


def time_constants(store: ResultStore) -> dict[str, tuple[float, float]]:
    """Return the time constants in s of the best parking circuit over its drive, by neuron."""
    for policy, drive in drives(store, BudgetName.PUBLISHED)[:1]:
        ranges = time_constant_ranges(policy.circuit, drive.potentials, policy.sensing.neurons)
        return {each.neuron: (each.lowest_s, each.highest_s) for each in ranges}
    return {}
