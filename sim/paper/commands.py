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
    STATUS = "status"
    REPLAY = "replay"
    RANDOM_CIRCUITS = "random-circuits"
    POLICY_GRADIENTS = "policy-gradients"
    NETWORKS = "networks"
    COMPARISONS = "comparisons"
    CLAIMS = "claims"
    PARAMETERS = "parameters"
    TIME_CONSTANTS = "time-constants"
    CONTRIBUTIONS = "contributions"
    CURVES = "curves"
    LESIONS = "lesions"


_SELECTION = {"task", "agent", "seed", "circuit", "budget", "runs"}
_OPTIONS = {
    What.RUN: _SELECTION | {"again", "processes", "cluster"},
    What.REPLAY: _SELECTION,
    What.STATUS: {"budget", "runs"},
    What.RANDOM_CIRCUITS: {"budget", "runs"},
    What.POLICY_GRADIENTS: {"budget", "runs"},
    What.NETWORKS: {"budget", "runs"},
    What.COMPARISONS: {"agent", "budget", "runs"},
    What.CLAIMS: {"runs"},
    What.PARAMETERS: set[str](),
    What.TIME_CONSTANTS: {"runs"},
    What.CONTRIBUTIONS: {"runs"},
    What.CURVES: {"budget", "runs", "out"},
    What.LESIONS: {"task", "runs", "out"},
}
"""Options that each action uses, beside --json."""


def paper(
    what: Annotated[
        What,
        typer.Argument(
            help="run: make runs. status: list existing runs and their commits. replay: score stored "
            "parameters again. random-circuits: Table II. policy-gradients: Table III. networks: Table IV. "
            "comparisons: the circuit against other agents, run by run. claims: what the paper says, and "
            "whether it holds here. parameters: of the experiments. time-constants and contributions: of the "
            "parking circuits. curves: a picture of the learning. lesions: the circuits without each neuron "
            "and synapse.",
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
            help="quick: seconds a run. default: minutes. published: the paper's iterations, and the search "
            "of its code. published-mean: with the mean of all rollouts. algorithm1: the search as printed.",
            show_default="default; of replay all",
        ),
    ] = None,
    runs: Annotated[
        Path | None,
        typer.Option(help="Folder of your runs; they precede the shipped ones.", show_default="runs/paper"),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="curves, lesions: the picture.", show_default="runs/paper/ and the name, .png"),
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
    cluster: Annotated[
        str | None,
        typer.Option(
            help="Address of a Dask scheduler (tcp://HOST:8786) whose workers make the runs.",
            show_default=False,
        ),
    ] = None,
    json: Json = False,
) -> int:
    """Reproduce the paper's experiments: a grid of runs (task, agent, seed), and the tables of their results.

    Each run is one small file with its settings, versions, learning curve and trained parameters. Existing
    runs, yours or shipped ones, are not repeated, so an interrupted command can be started again.

        rover-ncp paper status
        rover-ncp paper run --task mountain-car --agent circuit --seed 3 --again
        rover-ncp paper replay --task mountain-car
        rover-ncp paper run --task cart-pole --circuit mine.bnn
        rover-ncp paper run --cluster tcp://192.168.1.5:8786
        rover-ncp paper run --budget published --task parking
        rover-ncp paper networks --json
    """
    from sim.paper.agents import AGENTS
    from sim.paper.results import ResultStore
    from sim.paper.selection import select

    given: dict[str, Any] = {
        "task": task,
        "agent": agent,
        "seed": seed,
        "circuit": circuit,
        "budget": budget,
        "runs": runs,
    }
    given |= {"out": out, "again": again, "processes": processes, "cluster": cluster}
    reject(f"has no effect on {what}", **{k: v for k, v in given.items() if k not in _OPTIONS[what]})
    runs = runs or Path("runs/paper")
    output, store = Output(json), ResultStore(runs)
    if what is What.REPLAY:
        agents = agent if agent or circuit else AGENTS  # no stored run needs torch to be scored
        names = select(task, agents, seed, circuit, [budget] if budget else BudgetName)
        return _replay(output, store, names, circuit)
    budget = budget or BudgetName.DEFAULT
    if what is not What.RUN:
        _show(what, output, store, out=out, budget=budget, tasks=task, agents=agent)
        return 0
    if cluster is not None and (processes is not None or circuit is not None):
        raise UsageError("--cluster goes with neither --processes nor --circuit, a file of this machine")
    names = select(task, agent, seed, circuit, [budget])
    left = [name for name in names if again or store.find(name) is None]
    made = []
    if left:
        made = _make(output, store, left, circuit=circuit, processes=processes, cluster=cluster)
    output.result({"made": made, "found": len(names) - len(left)}, f"{len(made)} runs made")
    return 0


def _make(
    output: Output,
    store: Any,
    names: list[Any],
    *,
    circuit: Path | None,
    processes: int | None,
    cluster: str | None,
) -> list[dict[str, Any]]:
    """Make runs with a progress bar; return a summary of each."""
    from rich.console import Console
    from rich.progress import Progress

    from rover_ncp.core.files import require_writable
    from sim.learn.workers import available_processes
    from sim.paper.runs import make_runs

    made: list[dict[str, Any]] = []
    console = Console(stderr=True)
    progress = Progress(console=console, transient=True, disable=not console.is_terminal)
    bar = progress.add_task("runs", total=len(names))

    def on_result(result: Any) -> None:
        made.append(
            {
                "path": str(result.name.path(store.own)),  #: its file
                **result.name.model_dump(),
                **{name: getattr(result, name) for name in ("mean", "std", "plain_mean", "success")},
                **{name: getattr(result, name) for name in ("cpu_s", "steps", "ended", "budget")},
            }
        )
        progress.advance(bar)
        output.say(
            f"{result.name}: {result.mean:.4g} ± {result.std:.3g}{'' if result.success else ', no success'} "
            f"({result.cpu_s:.0f} s of a core, ended by {result.ended})"
        )

    require_writable(names[0].path(store.own))
    count = processes or available_processes()
    with progress:
        make_runs(names, store, circuit, processes=count, cluster=cluster, on_result=on_result)
    return made


def _show(
    what: What,
    output: Output,
    store: Any,
    *,
    out: Path | None,
    budget: BudgetName,
    tasks: list[str] | None,
    agents: list[str] | None,
) -> None:
    """Print a table or write the picture of the stored runs."""
    from sim.paper import interpretation, tables

    if what is What.STATUS:
        from sim.paper.selection import coverage

        groups = coverage(store, budget)
        output.result({"groups": groups}, tables.coverage_text(groups))
    elif what is What.CLAIMS:
        from sim.paper.claims import all_claims, claims_text

        claims = all_claims(store)
        output.result({"claims": claims}, claims_text(claims))
    elif what is What.COMPARISONS:
        from sim.paper.comparison import OTHERS, compare_agents, comparisons_text

        compared = [row for other in agents or OTHERS for row in compare_agents(store, other, budget)]
        output.result({"comparisons": [row.fields() for row in compared]}, comparisons_text(compared))
    elif what in tables.TABLES:
        rows = tables.table(what, store, budget)
        output.result(tables.table_fields(what, rows), tables.table_text(what, rows))
    elif what is What.PARAMETERS:
        found = tables.parameters()
        output.result({"tasks": found}, tables.parameters_text(found))
    elif what is What.TIME_CONSTANTS:
        constants = interpretation.parking_time_constants(store)
        output.result(constants, interpretation.time_constants_text(constants))
    elif what is What.CONTRIBUTIONS:
        signs = interpretation.parking_contributions(store)
        output.result(signs, interpretation.contributions_text(signs))
    else:
        _draw(what, output, store, out or Path(f"runs/paper/{what}.png"), tasks, budget)


def _draw(  # noqa: PLR0917  # those of the command
    what: What, output: Output, store: Any, out: Path, tasks: list[str] | None, budget: BudgetName
) -> None:
    """Write a picture of the stored runs, and print what it shows."""
    from rover_ncp.core.files import require_writable, write_atomic
    from sim.paper import curves, lesions
    from sim.paper.tasks import TASKS, find_task

    require_writable(out)
    names = [find_task(name).name for name in tasks or TASKS]
    fields: dict[str, Any] = {"picture": str(out)}
    text = str(out)
    if what is What.CURVES:
        picture = curves.curves_png(store, budget)
    else:
        fields["lesions"] = rows = lesions.lesion_study(store, names)
        picture, text = lesions.lesions_png(rows), lesions.lesions_text(rows)
    write_atomic(out, picture)
    output.result(fields, text)


def _replay(output: Output, store: Any, names: list[Any], circuit: Path | None) -> int:
    """Score stored parameters again; exit 1 if a verdict or a return differs."""
    from sim.paper.results import load_result
    from sim.paper.runs import agrees, replay

    differ, replayed, exact = [], 0, 0
    for name in names:
        path = store.find(name)
        if path is None:
            continue
        result = load_result(path)
        found = replay(result, circuit)
        replayed += 1
        exact += all(getattr(result, field) == value for field, value in found.items())
        if not agrees(result, found):
            differ.append({**name.model_dump(), "stored": result.mean, "replayed": found["mean"]})
    if not replayed:
        raise UsageError("there are no such runs to replay; rover-ncp paper status lists the runs that exist")
    output.result(
        {"replayed": replayed, "exact": exact, "differ": differ},
        f"{replayed} runs replayed, {exact} to the last bit, {len(differ)} differ",
    )
    return 1 if differ else 0
