"""The page: one self-contained HTML file without external requests."""

import json
import re
from importlib import resources
from typing import Any, NamedTuple

from deploy.report.analysis import analyse
from deploy.report.page.page_data import circuit_data, course_data, drive_data, findings
from deploy.report.recorded_drive import Drive
from deploy.report.summary import summarise


class Template(NamedTuple):
    """A page's frame, and its scripts in the order in which they build on each other."""

    frame: str
    scripts: tuple[str, ...]


DRIVE = Template(
    "page.html",
    ("shapes.js", "circuit.js", "plots.js", "pairs.js", "player.js", "page.js", "live.js"),
)
TRAINING = Template("training.html", ("shapes.js", "plots.js", "training.js"))
_ASSETS = resources.files("deploy.report.page") / "assets"


def drive_page(drive: Drive) -> str:
    """Return the report of a recorded drive as HTML."""
    summary = summarise(drive)
    return html(
        f"{summary.headline}: {drive.policy.circuit.name} on {drive.course.name}",
        {
            "live": False,
            "parked": summary.parked,
            "headline": summary.headline,
            "subline": summary.subline,
            "summary": summary.rows,
            "origin": summary.origin,
            "course": course_data(drive.course),
            "circuit": circuit_data(drive.policy),
            "drive": drive_data(drive.timeline),
            "findings": findings(analyse(drive.timeline.trace())),
        },
    )


def html(title: str, data: dict[str, Any], template: Template = DRIVE, connect: str = "'none'") -> str:
    """Return a page that shows ``data``; ``connect`` is the CSP source to which its script may connect.

    Everything is in the file, and its content security policy forbids the browser to fetch anything else.
    """
    from plotly.offline import get_plotlyjs

    parts = {
        "title": _escaped(title),
        "connect": connect,
        "style": _asset("page.css"),
        "data": _in_script(json.dumps(data, allow_nan=False, separators=(",", ":"), ensure_ascii=False)),
        "script": _in_script("\n".join(_asset(name) for name in template.scripts)),
        "plotly": _in_script(get_plotlyjs()),
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], _asset(template.frame))


def _asset(name: str) -> str:
    return (_ASSETS / name).read_text("utf-8")


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def _in_script(text: str) -> str:
    """Return a script whose strings cannot end the element it stands in, nor open a comment there."""
    return re.sub(r"<(?=/script|script|!--)", r"\\u003c", text, flags=re.IGNORECASE)
