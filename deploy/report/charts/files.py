"""An analysis as files: tables in CSV and pictures in SVG and PNG, by name without a suffix."""

import csv
import io
from collections.abc import Iterable, Sequence
from typing import Any

from deploy.report.analysis import Analysis
from deploy.report.charts import circuit as picture_circuit
from deploy.report.charts import neuron_pairs as picture_pairs
from deploy.report.charts import trajectory as picture_trajectory
from deploy.report.charts.figure import Picture
from deploy.report.interpretation import BINS, Contribution
from deploy.report.phases import Phase
from deploy.report.published import CONTRIBUTIONS, TIME_CONSTANTS_S
from rover_ncp.course.course import Course


def table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a CSV file: numbers with all their digits, empty cells for missing values."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(header)
    for row in rows:
        writer.writerow(["" if value is None else value for value in row])
    return buffer.getvalue()


def tables(analysis: Analysis) -> dict[str, str]:
    """Return the tables: potentials, contributions, time_constants, phases."""
    trace = analysis.trace
    return {
        "potentials": table(
            ["t_s", *(f"{name}_mV" for name in trace.neurons)],
            ([t, *row] for t, row in zip(trace.times.tolist(), trace.potentials.tolist(), strict=True)),
        ),
        "contributions": _contributions(analysis),
        "time_constants": table(
            ["neuron", "lowest_s", "highest_s", "paper_lowest_s", "paper_highest_s"],
            ([*row, *TIME_CONSTANTS_S.get(row.neuron, (None, None))] for row in analysis.time_constants),
        ),
        "phases": table(
            [
                "phase",
                "start_s",
                "end_s",
                "driven_m",
                "turned_rad",
                "motor",
                "behind",
                "activity",
                "sentence",
            ],
            (
                [
                    *_figures(each.phase),
                    each.motor.neuron,
                    each.behind.neuron if each.behind else None,
                    each.activity,
                    each.text,
                ]
                for each in analysis.explanations
            ),
        ),
    }


def pictures(analysis: Analysis, course: Course) -> dict[str, Picture]:
    """Draw trajectory, activity, circuit, slopes (to the motor neurons and of all pairs), phase_plots."""
    trace, found = analysis.trace, analysis.contributions
    return {
        "trajectory": picture_trajectory.trajectory(
            trace, course, [each.phase for each in analysis.explanations]
        ),
        "activity": picture_trajectory.activity(trace, course),
        "circuit": picture_circuit.circuit(trace, analysis.time_constants),
        "slopes": picture_pairs.slope_histograms(found, analysis.sources, analysis.motors),
        "slopes_of_all_pairs": picture_pairs.slope_histograms(found, trace.neurons, trace.neurons),
        "phase_plots": picture_pairs.phase_plots(trace, analysis.sources, analysis.motors),
    }


def _contributions(analysis: Analysis) -> str:
    rows = []
    for pair, whole in analysis.contributions.items():
        driving = analysis.driving[pair]
        paper = CONTRIBUTIONS.get(pair)
        rows.append(
            [*pair, *_counts(whole), *_counts(driving), None if paper is None else str(paper), *whole.bins]
        )
    counts = ["sign", "P", "Q", "flat", "vertical"]
    header = ["source", "destination", *counts, *(f"driving_{name}" for name in counts), "paper_sign"]
    return table([*header, *(f"bin_{number}" for number in range(BINS))], rows)


def _counts(one: Contribution) -> list[Any]:
    return [
        str(one.sign),
        one.positive,
        one.negative,
        one.flat,
        one.vertical,
    ]


def _figures(phase: Phase) -> list[Any]:
    return [phase.label, phase.start_s, phase.end_s, phase.driven_m, phase.turned_rad]
