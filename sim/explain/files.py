"""An explanation as text and files: sections for terminal and Markdown, tables in CSV, page and picture."""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from deploy.view.findings import Findings
from deploy.view.interpretation import (
    BINS,
    PUBLISHED_SIGNS,
    PUBLISHED_TIME_CONSTANTS_S,
    SYMBOLS,
    THRESHOLD,
    Contribution,
)
from deploy.view.sentences import number
from rover_ncp.core.files import write_atomic
from sim.explain.explain import Explanation
from sim.explain.what_if import STEP, Knockout, Sensitivity

IN_TEXT, ON_PAGE = 12, 25
"""Parameters in the text and on the page; the CSV file has them all."""
MIN_CHANGE = 0.01
"""Least change of a drive's return that counts."""
MIN_SHARE = 0.01
"""Least change of a task's return that counts, as a share of the return."""


SENSITIVITIES = f"Change of the return when a parameter moves by {100 * STEP:g} % of its range"


class Section(NamedTuple):
    """A section of the text: a table with words before and after it."""

    title: str
    before: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    after: str


def sections(found: Explanation) -> Iterator[Section]:
    """Yield the sections of an explanation."""
    run, sign = found.findings, f"{THRESHOLD:g}"
    yield Section(
        "Contributions to the motor neurons",
        f"Definition 1, P/Q: + positive if P > {sign} Q, − antagonistic if Q > {sign} P, ± phase-switching.\n"
        "Vertical slopes, where the source's potential was constant, count.",
        ["from", *(f"to {motor}" for motor in run.motors)],
        [[name, *(_signs(run.contributions[name, motor]) for motor in run.motors)] for name in run.sources],
        "",
    )
    parks = found.course is not None  # as the circuit whose figures the paper has
    if parks and (pairs := [pair for pair in PUBLISHED_SIGNS if pair in run.contributions]):
        yield _compared(run, pairs)
    yield Section(
        "Time constants (s)",
        "",
        ["neuron", "this run", *(["in the paper (Table S7)"] if parks else [])],
        [
            [
                neuron,
                f"{low:.3g} to {high:.3g}",
                *(["{:.3g} to {:.3g}".format(*paper) if paper else ""] if parks else []),
            ]
            for neuron, low, high in run.time_constants
            for paper in [PUBLISHED_TIME_CONSTANTS_S.get(neuron)]
        ],
        "",
    )
    yield _without(found) if found.course is not None else _without_in_task(found)
    yield Section(
        SENSITIVITIES,
        "",
        ["parameter", "value", "lower", "higher"],
        [_sensitivity(row) for row in _deepest(found, IN_TEXT)],
        "",
    )


def markdown(found: Explanation) -> str:
    """Return an explanation as Markdown; it shows ``circuit.svg`` of the same folder."""
    blocks = [
        f"# {found.title}",
        f"Made by `{found.command} --out FOLDER`.\nThis run: {found.ending}.",
        "\n".join(f"{i}. {sentence}" for i, sentence in enumerate(found.findings.sentences, 1)),
        "A pull is how far one synapse moves the potential that its neuron approaches, in mV, as a mean\n"
        "over the phase. Of a mixture of inputs or outputs the two largest parts are named.",
        "![circuit](circuit.svg)",
        "Each neuron is filled up to its mean potential, and each line is as thick as its mean current.\n"
        "Arrows excite, bars inhibit, dashed lines are gap junctions. Rings show ranges of time constants.",
    ]
    for title, before, header, rows, after in sections(found):
        lines = [f"| {' | '.join(row)} |" for row in (header, *rows)]
        lines.insert(1, "|---" * len(header) + "|")
        blocks += [f"## {title}", before, "\n".join(lines), after]
    return "\n\n".join(block for block in blocks if block) + "\n"


def write(found: Explanation, folder: Path) -> list[Path]:
    """Write page, text, tables and the circuit's picture; return the files. Raises FileError."""
    from deploy.view.page import circuit_svg  # the text needs no templates

    files = {
        "explanation.md": markdown(found),
        "explanation.html": page(found),
        "circuit.svg": circuit_svg(found.findings),
        **{f"{name}.csv": text for name, text in _tables(found).items()},
    }
    for name, content in files.items():
        write_atomic(folder / name, content)
    return [folder / name for name in sorted(files)]


def page(found: Explanation) -> str:
    """Return an explanation as a page."""
    from deploy.view.page import Table, run_page

    verdict = found.verdict
    if verdict is None:
        headline = f"mean return {number(found.intact.total)}", "", f"of {len(found.returns)} episodes"
    elif verdict.parked:
        headline = "Parked", "good", ""
    else:
        headline = "Not parked", "bad", verdict.reason
    drives = found.course is not None
    parts = sorted(found.knock_outs, key=lambda row: row.total)
    return run_page(
        found.findings,
        found.course,
        title=found.title,
        headline=headline,
        rows=[("Result", found.ending), ("Command", found.command)],
        tables=[
            Table(
                "Without a part",
                f"The simulation without each neuron and each synapse. The return of the whole circuit is "
                f"{number(found.intact.total)}.",
                ["without", "return", *(["m from the goal", "parks"] if drives else [])],
                [(_part(row), -row.change) for row in parts],
            ),
            Table(
                SENSITIVITIES,
                f"The {ON_PAGE} parameters with the largest loss of return.",
                ["parameter", "value", "lower", "higher"],
                [(_sensitivity(row), -row.worst) for row in _deepest(found, ON_PAGE)],
            ),
        ],
    )


def _part(row: Knockout) -> list[str]:
    if row.error_m is None:
        return [row.title, number(row.total)]
    return [row.title, number(row.total, ".2f"), f"{row.error_m:.2f}", "yes" if row.parked else "no"]


def _deepest(found: Explanation, count: int) -> list[Sensitivity]:
    return sorted(found.sensitivities, key=lambda row: row.worst)[:count]


def _sensitivity(row: Sensitivity) -> list[str]:
    changes = [number(change, "+.3g") for change in (row.change_down, row.change_up)]
    return [row.title, f"{number(row.value)} {row.unit}".strip(), *changes]


def _without(found: Explanation) -> Section:
    parks = found.intact.verdict is not None and found.intact.verdict.parked
    worse = [row for row in found.knock_outs if (not row.parked if parks else row.change <= -MIN_CHANGE)]
    needed = sorted(worse, key=lambda row: row.total)
    spared = [row.title for row in found.knock_outs if row not in needed and abs(row.change) < MIN_CHANGE]
    before = (
        f"Without any of these {len(needed)} it does not park:"
        if parks
        else "The whole circuit does not park in simulation; its return is "
        f"{number(found.intact.total, '.2f')}. Without any of these {len(needed)} the return is lower:"
    )
    return Section(
        "Without a part",
        before,
        ["without", "return", "m from the goal"],
        [_part(row)[:3] for row in needed],
        _spared(spared),
    )


def _without_in_task(found: Explanation) -> Section:
    least = MIN_SHARE * abs(found.intact.total)
    rows = sorted((row for row in found.knock_outs if abs(row.change) >= least), key=lambda row: row.total)
    return Section(
        "Without a part",
        f"Mean return of {len(found.returns)} episodes; {number(found.intact.total)} with all parts.",
        ["without", "return"],
        [_part(row) for row in rows],
        _spared([row.title for row in found.knock_outs if abs(row.change) < least]),
    )


def _spared(titles: Sequence[str]) -> str:
    return f"Without any of these nothing changes: {', '.join(titles)}." if titles else ""


def _compared(run: Findings, pairs: Sequence[tuple[str, str]]) -> Section:
    rows = []
    for pair in pairs:
        one, driving = run.contributions[pair], run.driving[pair]
        words = f"{one.vertical} of {one.positive + one.negative}"
        rows.append([*pair, str(one.sign), words, str(driving.sign), str(PUBLISHED_SIGNS[pair])])
    same, same_driving = (
        sum(found[pair].sign is PUBLISHED_SIGNS[pair] for pair in pairs)
        for found in (run.contributions, run.driving)
    )
    return Section(
        "Comparison with the paper's circuit",
        "",
        ["from", "to", "whole run", "vertical", "while driving", "in the paper"],
        rows,
        f"{same} of {len(pairs)} signs are the paper's over the whole run, {same_driving} while driving.\n"
        "Circuits of one wiring that were trained separately solve the task in different ways: the signs\n"
        "describe one circuit, not the wiring.",
    )


def _tables(found: Explanation) -> dict[str, str]:
    run = found.findings
    trace, counts = run.trace, ("sign", "P", "Q", "flat", "vertical")
    figures = ("label", "start_s", "end_s", "driven_m", "turned_rad")
    return {
        "potentials": _csv(
            ["t_s", *(f"{name}_mV" for name in trace.neurons)],
            ([t, *row] for t, row in zip(trace.times.tolist(), trace.potentials.tolist(), strict=True)),
        ),
        "contributions": _csv(
            ["source", "destination", *counts, *(f"driving_{name}" for name in counts), "paper_sign"]
            + [f"bin_{bin_}" for bin_ in range(BINS)],
            (
                [*pair, *_counts(one), *_counts(run.driving[pair]), PUBLISHED_SIGNS.get(pair), *one.bins]
                for pair, one in run.contributions.items()
            ),
        ),
        "time_constants": _csv(
            ["neuron", "lowest_s", "highest_s", "paper_lowest_s", "paper_highest_s"],
            ([*row, *PUBLISHED_TIME_CONSTANTS_S.get(row.neuron, (None, None))] for row in run.time_constants),
        ),
        "phases": _csv(
            ["phase", *figures[1:], "motor", "behind", "opening", "sentence"],
            (
                [
                    *(getattr(one.phase, name) for name in figures),
                    one.motor.neuron,
                    one.behind and one.behind.neuron,
                    one.opening,
                    sentence,
                ]
                for one, sentence in zip(run.explanations, run.sentences, strict=True)
            ),
        ),
        "knock_outs": _csv(vars(found.knock_outs[0]), (vars(row).values() for row in found.knock_outs)),
        "sensitivities": _csv(
            [*vars(found.sensitivities[0]), "slope"],
            ([*vars(row).values(), row.slope] for row in found.sensitivities),
        ),
    }


def _csv(header: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return a CSV file: numbers with all their digits, empty cells for None."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return buffer.getvalue()


def _signs(one: Contribution) -> str:
    return f"{SYMBOLS[one.sign]} {one.positive}/{one.negative}"


def _counts(one: Contribution) -> list[Any]:
    return [one.sign, one.positive, one.negative, one.flat, one.vertical]
