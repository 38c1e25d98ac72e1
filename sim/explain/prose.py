"""Findings as a page of Markdown: sentences, tables beside the paper's, the pictures beside it."""

from collections.abc import Iterable, Iterator, Sequence

from deploy.report.charts.neuron_pairs import SYMBOLS
from deploy.report.interpretation import Contribution
from deploy.report.published import CONTRIBUTIONS, TIME_CONSTANTS_S
from sim.explain.explained import Explained
from sim.explain.sensitivity import STEP

SHOWN = 10
"""Parameters in the table of sensitivities; the CSV has them all."""
LOST = 0.01
"""A smaller change of the return is none."""


def prose(found: Explained) -> str:
    """Return the page; it names pictures that lie in the same folder."""
    blocks = [
        _beginning(found),
        _contributions(found),
        _beside_the_paper(found),
        _time_constants(found),
        _knock_outs(found),
        _sensitivities(found),
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block) + "\n"


def _beginning(found: Explained) -> list[str]:
    verdict = found.verdict
    ending = "parked" if verdict.parked else f"not parked: {verdict.reason}"
    total = _number(found.intact.total, 4)
    return [
        f"# {found.policy.circuit.name} on {found.course.name}",
        "",
        f"Made by `rover-ncp explain {found.source} --out FOLDER`.",
        f"This run: {ending}; return in simulation {total}.",
        "",
        *(
            f"{number}. {explanation.text}"
            for number, explanation in enumerate(found.analysis.explanations, 1)
        ),
        "",
        "A pull is how far one synapse moves the potential its neuron is heading for, in mV, as a mean over",
        "the phase.",
        "",
        *_pictures("trajectory", "circuit", "activity"),
    ]


def _contributions(found: Explained) -> list[str]:
    analysis = found.analysis
    rows = [
        [name, *(_counts(analysis.contributions[name, motor]) for motor in analysis.motors)]
        for name in analysis.sources
    ]
    return [
        "## Contributions to the motor neurons",
        "",
        f"Definition 1, P/Q: + positive if P > {analysis.threshold:g} Q, − antagonistic if Q > "
        f"{analysis.threshold:g} P, ± phase-switching. Vertical slopes, where the source stood still, count.",
        "",
        *_table(["from", *(f"to {motor}" for motor in analysis.motors)], rows),
        "",
        *_pictures("slopes", "phase_plots"),
    ]


def _beside_the_paper(found: Explained) -> list[str]:
    analysis = found.analysis
    pairs = [pair for pair in CONTRIBUTIONS if pair in analysis.contributions]
    if not pairs:
        return []
    rows = []
    for pair in pairs:
        one, driving = analysis.contributions[pair], analysis.driving[pair]
        words = f"{one.vertical} of {one.positive + one.negative}"
        rows.append([*pair, str(one.sign), words, str(driving.sign), str(CONTRIBUTIONS[pair])])
    same = sum(analysis.contributions[pair].sign is CONTRIBUTIONS[pair] for pair in pairs)
    driving_same = sum(analysis.driving[pair].sign is CONTRIBUTIONS[pair] for pair in pairs)
    return [
        "## Beside the paper's circuit",
        "",
        *_table(["from", "to", "whole run", "vertical", "while driving", "in the paper"], rows),
        "",
        f"{same} of {len(pairs)} signs are the paper's over the whole run, {driving_same} while driving.",
        "Circuits of one wiring that were trained apart solve the task in different ways: the signs describe",
        "one circuit, not of the wiring.",
    ]


def _time_constants(found: Explained) -> list[str]:
    rows = []
    for row in found.analysis.time_constants:
        paper = TIME_CONSTANTS_S.get(row.neuron)
        theirs = f"{paper[0]:.3g} to {paper[1]:.3g}" if paper else ""
        rows.append([row.neuron, f"{row.lowest_s:.3g} to {row.highest_s:.3g}", theirs])
    return ["## Time constants (s)", "", *_table(["neuron", "this run", "in the paper (Table S7)"], rows)]


def _knock_outs(found: Explained) -> list[str]:
    needed = sorted((row for row in found.knock_outs if not row.parked), key=lambda row: row.total)
    spared = [row.name for row in found.knock_outs if row.parked and abs(row.change) < LOST]
    rows = [
        [
            f"neuron {row.name}" if row.kind == "neuron" else _arrow(row.name),
            _number(row.total, 2),
            f"{row.error_m:.2f}",
        ]
        for row in needed
    ]
    lines = ["## Without a part", "", f"Without any of these {len(needed)} it does not park:", ""]
    lines += _table(["without", "return", "m from the goal"], rows)
    if spared:
        lines += ["", f"Without any of these nothing changes: {', '.join(_arrow(name) for name in spared)}."]
    return [*lines, "", *_pictures("knock_outs")]


def _sensitivities(found: Explained) -> list[str]:
    rows = [
        [
            f"{row.kind.replace('_', ' ')}, {_arrow(row.name)}",
            f"{row.value:.4g} {row.unit}",
            _number(row.change_down, 3, signed=True),
            _number(row.change_up, 3, signed=True),
        ]
        for row in sorted(found.sensitivities, key=lambda row: row.worst)[:SHOWN]
    ]
    header = ["parameter", "value", "lower", "higher"]
    title = f"## Change of the return when a parameter moves by {100 * STEP:g} % of its range"
    return [title, "", *_table(header, rows), "", *_pictures("sensitivities")]


def _counts(contribution: Contribution) -> str:
    return f"{SYMBOLS[contribution.sign]} {contribution.positive}/{contribution.negative}"


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    yield f"| {' | '.join(header)} |"
    yield "|---" * len(header) + "|"
    for row in rows:
        yield f"| {' | '.join(row)} |"


def _pictures(*names: str) -> Iterator[str]:
    for name in names:
        yield f"![{name.replace('_', ' ')}]({name}.png)"


def _arrow(name: str) -> str:
    return name.replace("->", "→")


def _number(value: float, digits: int, signed: bool = False) -> str:
    return f"{value:{'+' if signed else ''}.{digits}f}".replace("-", "−")
