"""An agent between two iterations as a JSON file: numbers read back to the same bits."""

import json
from pathlib import Path
from typing import Any

from pydantic import Field

from rover_ncp.core.config import StrictModel
from rover_ncp.core.errors import FileError
from rover_ncp.core.files import read_text, write_atomic
from sim.learn.agents import AgentState, Plan, revive
from sim.learn.search.base import dump_state


class _AgentFile(StrictModel):
    format: int = Field(default=1, ge=1, le=1)
    agent: int = Field(ge=0)
    improvements: tuple[tuple[int, float], ...]
    search: dict[str, Any]


def save_agent(path: Path, agent: AgentState) -> None:
    """Write an agent. Raises FileError when the place cannot be written."""
    data = {"format": 1, "agent": agent.number, "improvements": agent.improvements, "search": agent.search}
    write_atomic(path, dump_state(data) + "\n")


def load_agent(path: Path, number: int, plan: Plan) -> AgentState:
    """Read agent ``number`` of a plan. Raises FileError for a file that is damaged or another agent's."""
    try:
        data = _AgentFile.model_validate(json.loads(read_text(path)))
        agent = AgentState(number, data.search, data.improvements)
        search = revive(plan, agent)
        last = agent.improvements[-1] if agent.improvements else (search.iterations, search.value)
        if data.agent != number or last[0] > search.iterations or last[1] != search.value:
            raise ValueError("it does not fit together")
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise FileError(
            f"{path}: damaged, or not agent {number} of this run; delete it to redo it"
        ) from error
    return agent
