"""Results of the command ``paper``."""

from pydantic import BaseModel, Field

from sim.paper import BudgetName
from sim.paper.claims import Judged
from sim.paper.results import RunName, RunSummary


class MadeRun(RunName, RunSummary):
    """A run that was made now."""

    path: str = Field(description="its file")


class MadeResult(BaseModel):
    """Result of ``paper run``."""

    made: list[MadeRun] = Field(description="runs that were made now")
    found: int = Field(description="how many runs existed already")


class DifferentRun(RunName):
    """A run whose replay differs."""

    stored: float = Field(description="the mean return in the file")
    replayed: float = Field(description="the mean return now")


class ReplayResult(BaseModel):
    """Result of ``paper replay``."""

    replayed: int = Field(description="how many runs")
    exact: int = Field(description="of them to the last bit")
    differ: list[DifferentRun] = Field(description="runs whose verdict or return differs")


class Group(BaseModel):
    """Runs of a task and an agent."""

    budget: BudgetName = Field(description="how long a run may take: quick, default or published")
    task: str = Field(description="its name")
    agent: str = Field(description="circuit, network or search of the paper")
    made: int = Field(description="finished runs")
    runs: int = Field(description="runs that the grid wants")
    commits: dict[str, int] = Field(description="by commit: number of runs")
    ended: dict[str, int] = Field(description="by reason: number of runs")
    cpu_s: float = Field(description="CPU time")


class ReportResult(BaseModel):
    """Result of ``paper report``."""

    claims: list[Judged] = Field(description="one row each")
    groups: list[Group] = Field(description="the runs of a task and an agent each")
