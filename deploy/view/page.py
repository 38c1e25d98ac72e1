"""Pages: each is one self-contained HTML file, rendered from a template, without external requests.

Text from peers and policies reaches a page only through templates, which escape it, and through JSON.
"""

from collections import Counter
from importlib import resources
from typing import Any
from urllib.parse import urlsplit

from jinja2 import Environment, PackageLoader
from markupsafe import Markup, escape

from deploy.view.charts.figure import OUTLINE, FloatArray
from deploy.view.findings import Findings, analyse
from deploy.view.interpretation import SYMBOLS
from deploy.view.page_data import circuit_data, columns, course_data, event_rows, rings
from deploy.view.recorded_drive import Drive, summarise
from deploy.view.sentences import number
from rover_ncp.circuit.policy import Policy
from rover_ncp.course.course import Course

_ASSETS = resources.files("deploy.view") / "assets"
_TEMPLATES = Environment(loader=PackageLoader("deploy.view", "assets"), autoescape=True, trim_blocks=True)
_TEMPLATES.filters["number"] = number
_TEMPLATES.globals |= {
    "asset": lambda name: Markup((_ASSETS / name).read_text("utf-8")),
    "symbols": SYMBOLS,
}
_TEMPLATES.policies["json.dumps_kwargs"] = {
    "allow_nan": False,
    "separators": (",", ":"),
    "ensure_ascii": False,
}


def drive_page(drive: Drive) -> str:
    """Return the report of a recorded drive as HTML."""
    summary, findings = summarise(drive), analyse(drive.timeline.trace())
    events = event_rows(drive.timeline)
    verdict, _, reason = summary.headline.partition(": ")
    return page(
        "page.html",
        title=f"{summary.headline}: policy {drive.policy.circuit.name} on course {drive.course.name}",
        data={
            **_frame(drive.policy, drive.course, drive.outline),
            "news": {
                "reset": True,
                **columns(drive.timeline, Counter()),
                "events": events,
                "findings": findings_data(findings),
            },
        },
        html={
            "title": fragment("title", verdict, "good" if summary.parked else "bad", reason),
            "subline": escape(summary.subline),
            "summary": fragment("rows", summary.rows),
            "events": fragment("events", events),
            **findings_html(findings),
        },
        origin=summary.origin,
    )


def watch_page(
    robot: str, address: str, policy: Policy, course: Course, outline: FloatArray = OUTLINE
) -> str:
    """Return the page of ``watch`` as HTML; its script gets all news from the server at ``address``."""
    title = fragment("title", "waiting", "", "for the bridge")
    return page(
        "page.html",
        title=f"Watching {robot}",
        data=_frame(policy, course, outline),
        html={"title": title},
        live=True,
        address=address,
        port=urlsplit(address).port,
    )


def page(template: str, *, title: str, data: dict[str, Any], html: dict[str, Markup], **parts: Any) -> str:
    """Return a page with its script's ``data`` and the parts ``html``, by id.

    With ``live=True`` its script may connect to the page's own server.
    """
    from plotly.offline import get_plotlyjs

    return _TEMPLATES.get_template(template).render(
        title=title, data=data, html=html, plotly=Markup(get_plotlyjs()), **parts
    )


def fragment(name: str, *arguments: Any) -> Markup:
    """Return a part of a page, made by a macro of ``fragments.html``."""
    made: Markup = getattr(_TEMPLATES.get_template("fragments.html").module, name)(*arguments)
    return made


def findings_data(findings: Findings) -> dict[str, Any]:
    """Return the findings that a script shows: phases, and the contributions of all pairs."""
    fields = findings.fields(findings.contributions)
    return {name: fields[name] for name in ("phases", "contributions")}


def findings_html(findings: Findings) -> dict[str, Markup]:
    """Return the findings as parts of a page, by id."""
    return {
        "phases": fragment("phases", findings.sentences, findings.explanations),
        "rings": fragment("rings", rings(findings)),
        "signs": fragment("contributions", findings),
        "taus": fragment("time_constants", findings.time_constants),
    }


def _frame(policy: Policy, course: Course, outline: FloatArray = OUTLINE) -> dict[str, Any]:
    return {"course": course_data(course, outline), "circuit": circuit_data(policy)}
