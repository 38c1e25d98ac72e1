"""The hazard table, and what gate and page did in its words."""

import re
from itertools import repeat

import pytest
import yaml

from deploy.view.recorded_drive import drive_of, summarise
from kit.paths import DATA
from kit.virtual_drive import short_course
from rover_ncp.core.errors import FileError

WIDE = {"position_m": 2.0, "heading_rad": 3.0, "still_s": 0.1, "still_m": 1.0, "still_rad": 1.0}
COURSE = short_course(0.5, 0.0, **WIDE).model_copy(update={"horizon_s": 6.0})
"""Wherever the rover stops on it, its estimates alone are those of a parked rover."""
TABLE = yaml.safe_load((DATA / "hazards.yaml").read_text())


def cells(key, without=None):
    """Return the cells that have a key as parameters, each once for each of its injections."""
    found = []
    for name, cases in TABLE.items():
        for case, cell in cases.items():
            if key not in cell or without in cell:
                continue
            injections = cell["inject"] if isinstance(cell["inject"], list) else [cell["inject"]]
            checks = cell["check"] if isinstance(cell["check"], list) else repeat(cell["check"])
            for injection, check in zip(injections, checks, strict=False):
                one = cell | {"inject": injection, "check": check}
                found.append(pytest.param(one, id=f"{name}, {case}, {injection}"))
    return found


def cells_with_processes():
    """Return the cells that run with real processes, as parameters by the fault that they name."""
    return {
        cell["process"]: pytest.param(cell, id=f"{name}, {case}, {cell['process']}")
        for name, cases in TABLE.items()
        for case, cell in cases.items()
        if "process" in cell
    }


def gate_words(statuses):
    """Return what the gate did from its first lease on, in the table's words."""
    began = next((at for at, status in enumerate(statuses) if status.lease), len(statuses))
    driven = statuses[began:]
    if ended := next((status.ended for status in driven if status.ended), ""):
        return f"ends {ended}"
    held = [status.held for status in driven if status.held and status.sequence >= 5]
    # Between the hold and the driver's own stop there may be no status.
    before = next((status.stops for status in driven if status.sequence >= 5), {})
    held += (
        [name for name, count in driven[-1].stops.items() if count > before.get(name, 0)] if driven else []
    )
    return f"holds {held[0]}" if held else "drives"


def page_words(recording):
    """Return what the page of a recording says, in the table's words."""
    try:
        found = summarise(drive_of(recording))
    except FileError as error:
        assert "holds no tick of a drive" in str(error)
        return "no page"
    verdict = re.match(r"(not )?(parked|docked)", found.headline.lower())[0]
    rule = re.match(r"fault: stopped by ([^:]*)", dict(found.rows)["Ended as"])
    return f"{verdict} ({rule[1]})" if rule else verdict
