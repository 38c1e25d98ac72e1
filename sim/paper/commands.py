"""The command ``paper``; heavy libraries load only when it runs."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from rover_ncp.core.console import Json, Output, reject
from rover_ncp.core.errors import UsageError
from sim.paper import BudgetName


class What(StrEnum):
    """Actions on the paper's experiments."""

    RUN = "run"
    REPLAY = "replay"
    REPORT = "report"


_SELECTION = {"task", "agent", "seed", "budget"}
_OPTIONS = {
    What.RUN: _SELECTION | {"circuit", "again", "processes", "cluster", "checkpoint"},
    What.REPLAY: _SELECTION | {"circuit"},
    What.REPORT: {"long", "curves"},
}
"""Options of each action, besides --results and --json."""


def paper(
    what: Annotated[
        What,
        typer.Argument(
            help="run: make runs. replay: score stored parameters again. report: the paper's claims, and "
            "whether the runs reproduce them."
        ),
    ],
    *,
    task: Annotated[
        list[str] | None, typer.Option(help="Only this task; may be repeated.", show_default="all")
    ] = None,
    agent: Annotated[
        list[str] | None, typer.Option(help="Only this agent; may be repeated.", show_default="all")
    ] = None,
    seed: Annotated[
        list[int] | None, typer.Option(help="Only this seed; may be repeated.", show_default="all")
    ] = None,
    circuit: Annotated[
        Path | None,
        typer.Option(help="A wiring of your own, YAML or .bnn, as one more agent.", show_default=False),
    ] = None,
    budget: Annotated[
        BudgetName | None,
        typer.Option(
            help="quick: seconds a run. default: minutes. published: the paper's iterations with the search "
            "of its code. algorithm1: the same with the search as printed.",
            show_default="default; of replay all",
        ),
    ] = None,
    results: Annotated[Path, typer.Option(help="Folder of the runs.")] = Path("results"),
    long: Annotated[bool, typer.Option("--long", help="report: the tables of all claims and runs.")] = False,
    curves: Annotated[
        Path | None,
        typer.Option(help="report: write the published search's curves to this PNG.", show_default=False),
    ] = None,
    again: Annotated[bool, typer.Option("--again", help="Repeat runs that exist already.")] = False,
    processes: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=1000,
            help="Runs at the same time; results do not depend on it.",
            show_default="one for each core",
        ),
    ] = None,
    checkpoint: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Minutes between checkpoints of runs of the paper's own searches.",
            show_default="5",
        ),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(
            help="Address of a Dask scheduler (tcp://HOST:8786) whose workers make the runs.",
            show_default=False,
        ),
    ] = None,
    json: Json = False,
) -> int:
    """Reproduce the paper's experiments: a grid of runs (task, agent, seed), and the claims that they test.

    A run is one line of RESULTS/BUDGET/TASK.jsonl: settings, versions, learning curve, trained parameters.
    Existing runs are not repeated. An interrupted run of the paper's own searches continues from its last
    checkpoint when the command is repeated.

        rover-ncp paper report
        rover-ncp paper run --task mountain-car --agent circuit --seed 3 --again
        rover-ncp paper replay --task mountain-car
        rover-ncp paper run --task cart-pole --circuit mine.bnn
        rover-ncp paper run --cluster tcp://192.168.1.5:8786
        rover-ncp paper run --budget published --task parking
    """
    from sim.paper.command_results import MadeResult
    from sim.paper.results import ResultStore
    from sim.paper.runs import is_stored
    from sim.paper.selection import select

    given: dict[str, Any] = {"task": task, "agent": agent, "seed": seed, "circuit": circuit, "budget": budget}
    given |= {"long": long, "curves": curves, "again": again, "processes": processes, "cluster": cluster}
    given["checkpoint"] = checkpoint
    reject(f"has no effect on {what}", **{k: v for k, v in given.items() if k not in _OPTIONS[what]})
    output, store = Output(json), ResultStore(results)
    if what is What.REPORT:
        return _report(output, store, long=long, curves=curves)
    if what is What.REPLAY:
        agents = [circuit.stem] if circuit else agent
        wanted = {"task": task, "agent": agents, "seed": seed, "budget": [budget] if budget else None}
        return _replay(output, store, wanted)
    if cluster is not None and any(each is not None for each in (processes, circuit, checkpoint)):
        raise UsageError("--cluster cannot be combined with --processes, --circuit or --checkpoint")
    names = select(task, agent, seed, circuit, budget or BudgetName.DEFAULT)
    left = [name for name in names if again or not is_stored(store, name, circuit)]
    every_s = 60.0 * (5.0 if checkpoint is None else checkpoint)
    options = {"circuit": circuit, "cluster": cluster, "processes": processes, "every_s": every_s}
    made = _make(output, store, left, options) if left else []
    result = MadeResult(made=made, found=len(names) - len(left))
    output.result(result.model_dump(), f"{len(made)} runs made")
    return 0


def _make(output: Output, store: Any, names: list[Any], options: dict[str, Any]) -> list[Any]:
    """Make runs; return a summary of each."""
    from rover_ncp.core.files import require_writable
    from sim.paper.command_results import MadeRun
    from sim.paper.results import RunSummary
    from sim.paper.runs import make_runs

    made: list[MadeRun] = []

    def on_result(result: Any) -> None:
        made.append(
            MadeRun(
                path=str(store.path(result.name.task, result.name.budget)),
                **result.name.model_dump(),
                **result.model_dump(include=set(RunSummary.model_fields)),
            )
        )
        outcome = "" if result.success else ", no success"
        output.say(
            f"{len(made)} of {len(names)}: {result.name}: {result.mean:.4g} ± {result.std:.3g}{outcome} "
            f"({result.cpu_s:.0f} s of a core, ended by {result.ended})"
        )

    require_writable(store.path(names[0].task, names[0].budget))
    make_runs(names, store, on_result=on_result, **options)
    return made


def _report(output: Output, store: Any, *, long: bool, curves: Path | None) -> int:
    """Print the report; write the learning curves if wanted."""
    from rover_ncp.core.files import require_writable, write_atomic
    from sim.paper.claims import judge_claims, load_claims
    from sim.paper.command_results import ReportResult
    from sim.paper.curves import curves_png
    from sim.paper.report import coverage, long_report, short_report

    if curves is not None:
        require_writable(curves)
        write_atomic(curves, curves_png(store))
    file = load_claims()
    judged = judge_claims(store, file.claims)
    text = long_report(store, judged) if long else short_report(store, file, judged)
    output.result(ReportResult(claims=judged, groups=coverage(store)).model_dump(), text)
    return 0


def _replay(output: Output, store: Any, wanted: dict[str, Any]) -> int:
    """Score the parameters of stored runs again; exit 1 if a verdict or a return differs.

    ``wanted`` has the values of some fields of a run's name; None: any.
    """
    from sim.paper.command_results import DifferentRun, ReplayResult
    from sim.paper.runs import agrees, replay

    differ, replayed, exact = [], 0, 0
    for result in store.every():
        name = result.name
        if not all(values is None or getattr(name, field) in values for field, values in wanted.items()):
            continue
        found = replay(result)
        replayed += 1
        exact += found == result.score
        if not agrees(result, found):
            differ.append(DifferentRun(**name.model_dump(), stored=result.mean, replayed=found.mean))
    if not replayed:
        raise UsageError(f"{store.folder}: has no such runs to replay")
    output.result(
        ReplayResult(replayed=replayed, exact=exact, differ=differ).model_dump(),
        f"{replayed} runs replayed, {exact} to the last bit, {len(differ)} differ",
    )
    return 1 if differ else 0
