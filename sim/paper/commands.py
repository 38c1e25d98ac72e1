"""The commands ``paper run``, ``replay`` and ``report``; heavy libraries load only when one of them runs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rover_ncp.core.console import Json, Output, Overwrite
from rover_ncp.core.errors import FileError, UsageError
from sim.paper import BudgetName

if TYPE_CHECKING:
    from sim.paper.results import Result

paper = typer.Typer(
    name="paper",
    no_args_is_help=True,
    add_completion=False,
    help="Reproduce the paper's experiments: make runs, replay them, report which claims they confirm.\n\n"
    "    rover-ncp paper run --budget quick --task parking",
)

Tasks = Annotated[list[str] | None, typer.Option(help="Only this task; may be repeated.", show_default="all")]
Agents = Annotated[
    list[str] | None, typer.Option(help="Only this agent; may be repeated.", show_default="all")
]
Seeds = Annotated[
    list[int] | None, typer.Option(min=0, help="Only this seed; may be repeated.", show_default="all")
]
Results = Annotated[Path, typer.Option(help="Folder of the runs.")]
RESULTS = Path("results")


@paper.command("run")
def run_experiments(
    *,
    task: Tasks = None,
    agent: Agents = None,
    seed: Seeds = None,
    budget: Annotated[
        BudgetName,
        typer.Option(
            help="published: the paper's iterations with the search of its code. algorithm1: the same with "
            "the search as printed. gradients: PPO and A2C. quick: published, but seconds a run."
        ),
    ] = BudgetName.PUBLISHED,
    results: Results = RESULTS,
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
    cluster: Annotated[
        str | None,
        typer.Option(
            help="Address of a Dask scheduler (tcp://HOST:8786) whose workers make the runs.",
            show_default=False,
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Make the runs that do not exist yet.

    A run is one line of RESULTS/BUDGET/TASK.jsonl: settings, versions, learning curve, trained parameters.
    An interrupted search continues from its last checkpoint when the command is repeated, by the same commit;
    not on a cluster.

        rover-ncp paper run --task parking
        rover-ncp paper run --task mountain-car --agent circuit --seed 3 --again
        rover-ncp paper run --cluster tcp://192.168.1.5:8786
    """
    from rover_ncp.core.files import require_writable
    from sim.paper.results import MadeResult, MadeRun, ResultStore, RunSummary
    from sim.paper.runs import make_runs
    from sim.paper.selection import select

    if cluster is not None and processes is not None:
        raise UsageError("--cluster cannot be combined with --processes")
    output, store = Output(json), ResultStore(results)
    names = select(task, agent, seed, budget)
    left = [name for name in names if again or store.find(name) is None]
    made: list[MadeRun] = []

    def on_result(result: "Result") -> None:
        summary = result.model_dump(include=set(RunSummary.model_fields))
        path = str(store.path(result.name.task, result.name.budget))
        made.append(MadeRun(path=path, **result.name.model_dump(), **summary))
        outcome = "" if result.success else ", no success"
        output.say(
            f"{len(made)} of {len(left)}: {result.name}: {result.mean:.4g} ± {result.std:.3g}{outcome} "
            f"({result.cpu_s:.0f} s of a core)"
        )

    if left:
        for path in {store.path(name.task, budget) for name in left}:
            require_writable(path, overwrite=True)
        make_runs(left, store, processes=processes, cluster=cluster, on_result=on_result)
    found = MadeResult(made=made, found=len(names) - len(left))
    output.result(found, f"{len(made)} runs made")


@paper.command("replay")
def replay_experiments(
    *,
    task: Tasks = None,
    agent: Agents = None,
    seed: Seeds = None,
    budget: Annotated[
        BudgetName | None, typer.Option(help="Only runs of this budget.", show_default="all")
    ] = None,
    results: Results = RESULTS,
    json: Json = False,
) -> int:
    """Score the parameters of stored runs again; exit 1 if a verdict or a return differs.

    rover-ncp paper replay --task mountain-car
    """
    from sim.paper.results import DifferentRun, ReplayResult, ResultStore
    from sim.paper.runs import agrees, replay

    wanted = {"task": task, "agent": agent, "seed": seed, "budget": budget and [budget]}
    differ, replayed, exact = [], 0, 0
    for result in ResultStore(results).every():
        name = result.name
        if not all(values is None or getattr(name, field) in values for field, values in wanted.items()):
            continue
        found = replay(result)
        replayed += 1
        exact += found == result.score
        if not agrees(result, found):
            differ.append(DifferentRun(**name.model_dump(), stored=result.mean, replayed=found.mean))
    if not replayed:
        raise UsageError(f"{results}: has no such runs to replay")
    Output(json).result(
        ReplayResult(replayed=replayed, exact=exact, differ=differ),
        f"{replayed} runs replayed, {exact} to the last bit, {len(differ)} differ",
    )
    return 1 if differ else 0


@paper.command("report")
def report_experiments(
    *,
    results: Results = RESULTS,
    long: Annotated[
        bool, typer.Option("--long", help="All claims, the settings and the stored runs.")
    ] = False,
    curves: Annotated[
        Path | None,
        typer.Option(help="Write the published search's curves to this PNG.", show_default=False),
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Report the paper's claims, and whether the stored runs reproduce them.

    Without --long it prints the first part of docs/paper.md.

        rover-ncp paper report
        rover-ncp paper report --curves curves.png
    """
    from rover_ncp.core.files import require_writable, write_atomic
    from sim.paper.claims import judge_claims, load_claims
    from sim.paper.curves import curves_png
    from sim.paper.report import ReportResult, coverage, long_report, short_report
    from sim.paper.results import ResultStore

    if curves is not None:
        require_writable(curves, overwrite=overwrite)
    if not results.is_dir():
        raise FileError(f"{results}: no such folder")
    store, file = ResultStore(results), load_claims()
    if curves is not None:
        write_atomic(curves, curves_png(store))
    judged = judge_claims(store, file.claims)
    text = long_report(store, judged) if long else short_report(store, file, judged)
    Output(json).result(ReportResult(claims=judged, groups=coverage(store)), text)
