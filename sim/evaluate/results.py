"""Results of the command ``eval``; those of trials and of the paper's benchmarks have more fields."""

from pydantic import BaseModel, Field

from sim.evaluate.evaluate import Evaluation
from sim.learn.results import VerdictFields
from sim.stack.estimates import EstimateSummary


class DriveOnceResult(VerdictFields):
    """Result of one drive on the nominal rover."""

    return_: float = Field(serialization_alias="return", description="the paper's; 0 is out of reach")
    rms_m: float = Field(description="of the distances to the checkpoints, each when it was judged")
    model: str | None = Field(description="the robot's description, if one was named")
    scaled: list[str] = Field(description="lines on the courses that were changed for the robot")


class TrialsResult(Evaluation):
    """Result of random trials."""

    randomize: str = Field(description="the name or file of the randomization")
    model: str | None = Field(description="the robot's description, if one was named")
    scaled: list[str] = Field(description="lines on the courses that were changed for the robot")
    body: str = Field(description="the simulator's")
    seed: int = Field(description="root seed")
    random_courses: int = Field(description="how many")
    course: str = Field(description="several are joined by commas")


class StackDrive(BaseModel):
    """One trial through the stack."""

    trial: int = Field(description="its number, from 0: with the root seed it gives the same robot again")
    parked: bool = Field(description="whether the rover parked, by its true pose; with --to: docked")
    reason: str = Field(description="why not, by the true pose, or the safety rule that stopped the drive")
    error_m: float = Field(description="final position error of the true pose")
    error_rad: float = Field(description="final heading error of the true pose")
    verdict: str | None = Field(description="the driver's; null if a safety rule stopped the drive")
    probability: float | None = Field(
        description="that the rover is within the tolerances, by the driver's estimate"
    )


class StackResult(BaseModel):
    """Fields of trials through the stack, beside those of all trials."""

    overruns: int = Field(description="of all trials")
    wall_s: float = Field(description="how long it took")
    times_real_time: float = Field(description="driven time over computing time")
    estimate: EstimateSummary = Field(description="of the driver, against the truth")
    drives: list[StackDrive] = Field(description="each trial")


class StackTrialsResult(StackResult, TrialsResult):
    """Result of random trials through the stack."""
