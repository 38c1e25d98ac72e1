"""Results of the command ``train``; those of ``eval`` share the verdict."""

from pydantic import BaseModel, Field

from rover_ncp.course.scoring import Failure
from sim.learn.settings import RobustSettings


class VerdictFields(BaseModel):
    """The fields of a `Verdict`."""

    parked: bool = Field(description="whether the rover parked")
    error_m: float = Field(description="final position error")
    error_rad: float = Field(description="final heading error")
    reason: str = Field(description="why it did not park, or empty")
    failure: Failure = Field(description="the first condition that was missed, or empty")


class TrainResult(VerdictFields):
    """Result of a training on one course; the verdict is the best agent's."""

    returns: list[float] = Field(description="by agent")
    best_return: float = Field(description="of all agents")
    median_return: float = Field(description="of all agents")
    wall_s: float = Field(description="how long it took")
    iterations_per_s: float | None = Field(description="of all agents together")
    seed: int = Field(description="root seed")
    agents: int = Field(description="how many")
    iterations: int = Field(description="of each agent")
    out: str = Field(description="the folder")
    policy: str = Field(description="the best agent's file")


class RobustResult(RobustSettings):
    """Result of a training on random trials."""

    generations: int = Field(description="how many were made")
    cost: float = Field(description="lowest of the last generation")
    policy: str = Field(description="its file")
