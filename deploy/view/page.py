"""Pages: each is one self-contained HTML file, rendered from a template, without external requests.

Text from peers and policies reaches a page only through templates, which escape it, and through JSON.
"""

import math
from collections import Counter
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from jinja2 import Environment, PackageLoader
from markupsafe import Markup, escape
from pydantic import Field

from deploy.view.page_data import (
    circuit_data,
    columns,
    course_data,
    event_rows,
    pictures,
    rings,
    trace_columns,
)
from deploy.view.recorded_drive import KINDS, Drive, read_drive, summarise
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.config import ResultModel
from rover_ncp.core.files import require_writable, write_atomic
from rover_ncp.course.course import Course
from rover_ncp.course.shapes import OUTLINE, FloatArray
from rover_ncp.neurons.findings import Findings, analyse, number
from rover_ncp.neurons.interpretation import SYMBOLS, Interpretation


def _bar(loss: float, most: float) -> int:
    """Return the length of a bar in %, logarithmic from a thousandth of the largest loss on."""
    return round(100 * math.log10(max(1.0, 1000 * loss / most)) / 3) if most > 0 else 0


_ASSETS = resources.files("deploy.view") / "assets"
_TEMPLATES = Environment(loader=PackageLoader("deploy.view", "assets"), autoescape=True, trim_blocks=True)
_TEMPLATES.filters |= {"number": number, "bar": _bar}
_TEMPLATES.globals |= {
    "asset": lambda name: Markup((_ASSETS / name).read_text("utf-8")),
    "symbols": SYMBOLS,
}
_TEMPLATES.policies["json.dumps_kwargs"] = {
    "allow_nan": False,
    "separators": (",", ":"),
    "ensure_ascii": False,
}


class Table(NamedTuple):
    """A table of what-ifs on a page: cells of each row, and a bar as long as the last number of the row."""

    title: str
    note: str
    header: Sequence[str]
    rows: Sequence[tuple[Sequence[str], float]]


class Report(ResultModel):
    """What ``rover-ncp report`` prints."""

    page: str = Field(description="its file")
    bytes: int = Field(description="its size")


def write_report(recording: Path, page: Path, *, overwrite: bool = False) -> Report:
    """Write the report of a recorded drive. Raises FileError and ConfigError."""
    require_writable(page, overwrite=overwrite)
    write_atomic(page, drive_page(read_drive(recording)))
    return Report(page=str(page), bytes=page.stat().st_size)


def drive_page(drive: Drive) -> str:
    """Return the report of a recorded drive as HTML."""
    summary, findings = summarise(drive), analyse(*drive.timeline.traces())
    events, seen = event_rows(drive.timeline), pictures(drive.timeline)
    verdict, _, reason = summary.headline.partition(": ")
    return page(
        title=f"{summary.headline}: {drive.names}",
        data=_data(drive.policy, drive.course, drive.outline)
        | {"updates": _updates(findings, columns(drive.timeline, Counter()), events)}
        | ({"pictures": seen} if seen else {}),
        html={
            "title": fragment("title", verdict, KINDS[summary.parked], reason),
            "subline": escape(summary.subline),
            "summary": fragment("rows", summary.rows),
            "events": fragment("events", events),
            "phases": fragment("phases", findings.phases),
        },
        origin=summary.origin,
    )


def run_page(
    findings: Findings,
    interpretation: Interpretation,
    course: Course | None,
    *,
    title: str,
    headline: tuple[str, str, str],
    rows: Sequence[tuple[str, str]],
    tables: Sequence[Table] = (),
    outline: FloatArray = OUTLINE,
) -> str:
    """Return a page on a run without a recording.

    ``headline`` is the badge, its kind (good, bad or empty) and words.
    """
    policy, pairs = findings.trace.policy, interpretation.contributions
    return page(
        title=title,
        data=_data(policy, course, outline)
        | {
            "updates": _updates(findings, trace_columns(findings.trace), []),
            "contributions": [each.model_dump(exclude={"driving"}) for each in pairs.values()],
            "simulated": True,
        },
        html={
            "title": fragment("title", *headline),
            "subline": escape(title),
            "summary": fragment("rows", rows),
            "phases": fragment("phases", findings.phases),
            "rings": fragment("rings", rings(policy, interpretation.time_constants)),
            "signs": fragment("contributions", interpretation),
            "taus": fragment("time_constants", interpretation.time_constants),
        },
        tables=tables,
    )


def watch_page(
    robot: str, address: str, policy: Policy, course: Course, outline: FloatArray = OUTLINE
) -> str:
    """Return the page of ``watch`` as HTML; its script gets all updates from the server at ``address``."""
    return page(
        title=f"Watching {robot}",
        data=_data(policy, course, outline),
        html={"title": fragment("title", "waiting", "", "for the bridge")},
        live=True,
        address=address,
        port=urlsplit(address).port,
    )


def page(*, title: str, data: dict[str, Any], html: dict[str, Markup], **parts: Any) -> str:
    """Return a page with its script's ``data`` and the parts ``html``, by id.

    With ``live=True`` its script may connect to the page's own server.
    """
    return _TEMPLATES.get_template("page.html").render(title=title, data=data, html=html, **parts)


def fragment(name: str, *arguments: Any) -> Markup:
    """Return a part of a page, made by a macro of ``fragments.html``."""
    made: Markup = getattr(_TEMPLATES.get_template("fragments.html").module, name)(*arguments)
    return made


def _data(policy: Policy, course: Course | None, outline: FloatArray = OUTLINE) -> dict[str, Any]:
    return {
        "course": None if course is None else course_data(course, outline),
        "circuit": circuit_data(policy),
    }


def _updates(
    findings: Findings, streams: dict[str, dict[str, Any]], events: list[dict[str, Any]]
) -> dict[str, Any]:
    return {
        "reset": True,
        **streams,
        "events": events,
        "phases": [phase.model_dump() for phase in findings.phases],
    }
