"""Commands of this package; heavy libraries load only when one runs."""

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rover_ncp.core.console import MAX_SEED, Json, Output, command, progress, reject
from rover_ncp.core.errors import UsageError
from sim.world.bodies import PRESETS, Body

if TYPE_CHECKING:
    from sim.learn.ensemble import TrainResult
    from sim.learn.robust import RobustResult
    from sim.learn.settings import RobustSettings, Settings, TrainSettings


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """Options of ``train``; those that decide its result have the names of its settings."""

    course: Annotated[
        str | None, typer.Option(help="Course to learn, by name or YAML file.", show_default="parking")
    ] = None
    circuit: Annotated[
        str | None,
        typer.Option(
            help="Circuit to start from, by name or file; or a policy file, with its sensing.",
            show_default="parking, tracking if random",
        ),
    ] = None
    model: Annotated[
        str | None,
        typer.Option(
            help="The robot's description, a name or a YAML file.", show_default="the paper's p3at-sh"
        ),
    ] = None
    seed: Annotated[
        int | None,
        typer.Option(min=0, max=MAX_SEED, help="Root seed of all random numbers.", show_default="0"),
    ] = None
    agents: Annotated[
        int | None,
        typer.Option(min=1, max=1000, help="Independent searches; the best one wins.", show_default="12"),
    ] = None
    iterations: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=10**9,
            help="Candidates that each agent tries; generations if random.",
            show_default="20000, 2600 if random",
        ),
    ] = None
    search: Annotated[
        str | None,
        typer.Option(
            help="gauss-newton (ours): descents on the residuals of all checkpoints. published (the "
            "paper's): a few random entries change. algorithm1 (the paper's, as printed): all "
            "change, by a scale that follows success.",
            show_default="gauss-newton",
        ),
    ] = None
    randomize: Annotated[
        str | None,
        typer.Option(
            help=f"Train on random trials: {', '.join(PRESETS[Body.PYMUNK][1:])} or a YAML file.",
            show_default=False,
        ),
    ] = None
    rollouts: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=100_000,
            help="Trials of a candidate.",
            show_default="144 if random",
        ),
    ] = None
    worst: Annotated[
        int | None,
        typer.Option(
            min=1, max=100_000, help="Number of worst rollouts in the average.", show_default="all rollouts"
        ),
    ] = None
    random_courses: Annotated[
        int | None,
        typer.Option(min=0, max=10_000, help="Courses beside the given one.", show_default="400 if random"),
    ] = None
    refine: Annotated[
        bool | None,
        typer.Option(
            "--refine",
            help="Begin with small steps: --circuit is a policy that parks already. 450 --iterations do.",
            show_default=False,
        ),
    ] = None
    profile: Annotated[
        Path | None,
        typer.Option(
            help="Rover profile, as 'identify' writes it; values not in it are drawn.",
            show_default=False,
        ),
    ] = None
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the run, missing or empty.", show_default="the next free runs/train-N"),
    ] = None
    resume: Annotated[bool, typer.Option("--resume", help="Continue the run in --out.")] = False
    processes: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=1000,
            help="Processes; the result does not depend on them.",
            show_default="one for each core",
        ),
    ] = None
    cluster: Annotated[
        str | None,
        typer.Option(
            help="Address of a Dask scheduler (tcp://HOST:8786) whose workers do the work. "
            "It must be trusted like this machine: its workers can run any code here.",
            show_default=False,
        ),
    ] = None
    json: Json = False


@command
def train(options: TrainOptions) -> None:
    """Train circuits in simulation until one drives a course.

    Agents start from the same untuned wiring and search independently. The default search, Gauss-Newton, is
    ours. The paper's is --search published: 11 of 48 of its runs park. A return is minus the sum of the
    squared errors at the checkpoints (1 rad counts as 1 m): 0 would be perfect, about -0.1 parks.

    In the folder: policy.yaml (the best agent's circuit, ready for deploy and eval), curve.csv and curve.png
    (best return so far of each agent), settings.yaml, agents/. The same settings give the same bytes, for
    any number of processes. A run can be interrupted at any time: with --resume it ends in the same files,
    and needs none of the options again. Agents that had not ended begin again. The run stays with the course,
    circuit, robot, randomization and profile that it began with: a file that has changed is an error. Other
    versions of the software are a warning.

        rover-ncp train --seed 1 --out runs/mine
        rover-ncp train --out runs/mine --resume

    A circuit with the motor neuron REV, such as four_dof, also drives backward.

    With --cluster, agents train on the workers of a Dask cluster, which need the same rover-ncp. The bytes
    are those of a run on this machine; a worker that dies costs time only. A cluster is trusted like this
    machine: its workers can run code here, and every peer that reaches the scheduler can run code on them.

        rover-ncp train --cluster tcp://192.168.1.5:8786

    With --randomize, a circuit learns to follow any course on randomised robots. It senses its pose relative
    to the course. The circuit, by default tracking, needs the neurons FWD and REV. A candidate's score is the
    mean over many random trials, and the search is CMA-ES. Iterations are its generations; those before 2000
    drive a part of the rollouts.

        rover-ncp train --randomize full --out runs/robust
        rover-ncp train --randomize full --profile profile.yaml --out runs/for-mine

    With --refine, a policy that parks already learns the robots of the trials in a third of the episodes.

        rover-ncp train --randomize full --circuit course --refine --iterations 450

    """
    from sim.learn.settings import RobustSettings

    output, settings = Output(options.json), _settings(options)
    if isinstance(settings, RobustSettings):
        reject("is for trainings without --randomize", cluster=options.cluster)
        found, words = _train_robust(output, options, settings)
    else:
        if options.cluster is not None:
            reject("does not go together with --cluster", processes=options.processes)
        found, words = _train_ensemble(output, options, settings)
    output.result(found, f"{words}\n{found.policy}")


_OF_THE_RUN = ("out", "resume", "processes", "cluster", "json")
"""Options that do not decide the result."""


def _settings(options: TrainOptions) -> "Settings":
    """Return the settings of a command's options, and of the run to go on with."""
    from rover_ncp.core.config import validated
    from sim.learn.folder import read_record
    from sim.learn.settings import RobustSettings, TrainSettings

    given: dict[str, Any] = {
        name: str(value) if isinstance(value, Path) else value
        for name, value in dataclasses.asdict(options).items()
        if value is not None and name not in _OF_THE_RUN
    }
    kind: type[Settings] = RobustSettings if "randomize" in given else TrainSettings
    before: dict[str, Any] = {}
    if options.resume:
        if options.out is None:
            raise UsageError("--resume needs --out, the folder of the run to go on with")
        saved = read_record(options.out).settings
        kind, before = type(saved), saved.model_dump()
    foreign = {name: given[name] for name in given if name not in kind.model_fields}
    reject(f"is for trainings {'with' if kind is TrainSettings else 'without'} --randomize", **foreign)
    return validated(before | given, kind, "train")


@contextmanager
def _progress(
    output: Output, options: TrainOptions, total: int, unit: str
) -> Iterator[tuple[Path, Callable[[int, object], None]]]:
    """Give the folder and a function that shows progress; say how to go on after an interruption."""
    from sim.learn.folder import new_run_path
    from sim.learn.workers import WorkerDied

    out = options.out or new_run_path()
    try:
        with progress(total, unit) as show:
            yield out, show
    except (KeyboardInterrupt, WorkerDied):
        output.say(f"Go on with: rover-ncp train --out {out} --resume")
        raise


def _train_ensemble(
    output: Output, options: TrainOptions, settings: "TrainSettings"
) -> "tuple[TrainResult | RobustResult, str]":
    """Train agents on one course."""
    from sim.learn.ensemble import TrainResult
    from sim.learn.ensemble import train as run_training
    from sim.learn.settings import load_task

    load_task(settings)  # before a folder is made, so that a typo leaves none behind
    with _progress(output, options, settings.agents, "agents") as (out, show):
        result = run_training(
            settings,
            out,
            resume=options.resume,
            processes=options.processes,
            cluster=options.cluster,
            on_progress=lambda ensemble: show(len(ensemble.agents), ensemble),
        )
    best, median = result.agents.best.value, result.agents.median_return
    found = TrainResult(
        **vars(result.verdict),
        returns=result.agents.returns,
        best_return=best,
        median_return=median,
        wall_s=result.wall_s,
        seed=settings.seed,
        agents=settings.agents,
        iterations=settings.iterations,
        out=str(out),
        policy=str(result.policy_path),
    )
    how = "parks" if result.verdict.parked else f"does not park: {result.verdict.reason}"
    words = f"return {best:.4f}, {how} (median {median:.4f}; {result.wall_s:.1f} s)"
    return found, f"best of {settings.agents} agents: {words}"


def _train_robust(
    output: Output, options: TrainOptions, settings: "RobustSettings"
) -> "tuple[TrainResult | RobustResult, str]":
    """Train on random trials."""
    from sim.learn.robust import RobustResult, train_robust
    from sim.learn.settings import load_task

    load_task(settings)  # before a folder is made, so that a typo leaves none behind
    with _progress(output, options, settings.iterations, "generations") as (out, show):
        policy, cost = train_robust(
            settings,
            out,
            resume=options.resume,
            processes=options.processes,
            on_generation=lambda done, cost: show(done, f"cost {cost:.4g}"),
        )
    generations = settings.iterations
    found = RobustResult(**settings.model_dump(), generations=generations, cost=cost, policy=str(policy))
    return found, f"cost {cost:.3f} after {generations} generations"
