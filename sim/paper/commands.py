"""The command ``paper``; heavy libraries load only when it runs."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from rover_ncp.core.console import Json, Output
from rover_ncp.core.errors import UsageError


class What(StrEnum):
    """Actions on the paper's experiments."""

    RUN = "run"
    STATUS = "status"
    REPLAY = "replay"
    TABLE1 = "table1"
    TABLE2 = "table2"
    TABLE3 = "table3"
    PARAMETERS = "parameters"
    TIME_CONSTANTS = "time-constants"
    CONTRIBUTIONS = "contributions"
    CURVES = "curves"


class Budget(StrEnum):
    """Budgets of a run; listed here so that --help need not import the tasks."""

    QUICK = "quick"
    DEFAULT = "default"
    PUBLISHED = "published"


def paper(
    what: Annotated[
        What,
        typer.Argument(
            help="run: make runs. status: which are made. replay: check them. table1: random circuits. "
            "table2: PPO and A2C. table3: networks. parameters: of the experiments. time-constants and "
            "contributions: of the parking circuits. curves: a picture of the learning."
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
        Budget, typer.Option(help="quick: seconds a run. default: minutes. published: the paper's.")
    ] = Budget.DEFAULT,
    runs: Annotated[Path, typer.Option(help="Folder of your runs, before those that are shipped.")] = Path(
        "runs/paper"
    ),
    out: Annotated[Path, typer.Option(help="curves: the picture.")] = Path("runs/paper/curves.png"),
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
    """Reproduce the paper's experiments: a grid of runs (task, agent, seed), and its tables made of them.

    Each run is one small file with its settings, versions, learning curve and trained parameters. Runs that
    are made, by you or with this package, are not made again; interrupt it whenever you like.

        rover-ncp paper status
        rover-ncp paper run --task mountain-car --agent circuit --seed 3 --again
        rover-ncp paper replay --task mountain-car
        rover-ncp paper run --task cart-pole --circuit mine.bnn
        rover-ncp paper run --cluster tcp://192.168.1.5:8786
        rover-ncp paper table3 --json
    """
    from rich.console import Console
    from rich.progress import Progress

    from rover_ncp.core.files import require_writable
    from sim.learn.workers import available_processes
    from sim.paper.cell import Shelf
    from sim.paper.choice import chosen
    from sim.paper.grid import make_runs
    from sim.paper.train import BudgetName

    output, shelf = Output(json), Shelf(runs)
    if what not in (What.RUN, What.REPLAY):
        _show(what, output, shelf, out)
        return 0
    if cluster is not None and (processes is not None or circuit is not None):
        raise UsageError("--cluster goes with neither --processes nor --circuit, a file of this machine")
    names = chosen(task, agent, seed, circuit)
    if what is What.REPLAY:
        return _replay(output, shelf, names, circuit)
    left = [name for name in names if again or shelf.find(name) is None]
    made: list[dict[str, Any]] = []
    console = Console(stderr=True)
    progress = Progress(console=console, transient=True, disable=not console.is_terminal)
    bar = progress.add_task("runs", total=len(left))

    def on_cell(cell: Any) -> None:
        made.append({"path": str(cell.name.path(runs)), **_summary(cell)})
        progress.advance(bar)
        output.say(
            f"{cell.name}: {cell.mean:.4g} ± {cell.std:.3g}{'' if cell.success else ', no success'} "
            f"({cell.cpu_s:.0f} s of a core, ended by {cell.ended})"
        )

    if left:
        require_writable(left[0].path(runs))
        count = processes or available_processes()
        with progress:
            make_runs(
                left, shelf, BudgetName(budget), circuit, processes=count, cluster=cluster, on_cell=on_cell
            )
    output.result({"made": made, "found": len(names) - len(left)}, f"{len(made)} runs made")
    return 0


def _show(what: What, output: Output, shelf: Any, out: Path) -> None:
    """Print what stands in the runs that are made."""
    from sim.paper import render, tables

    if what is What.STATUS:
        from sim.paper.grid import status

        rows = [
            {"task": group.task, "agent": group.agent, "made": made, "runs": group.runs}
            for group, made in status(shelf)
        ]
        lines = [f"{row['task']:17} {row['agent']:8} {row['made']} of {row['runs']} runs" for row in rows]
        output.result({"groups": rows}, "\n".join(lines))
    elif what in (What.TABLE1, What.TABLE2, What.TABLE3):
        found = tables.table(tables.Table(what), shelf)
        output.result({"cells": [entry.fields() for entry in found]}, render.table_text(found))
    elif what is What.PARAMETERS:
        rows = tables.parameters()
        output.result({"tasks": rows}, render.parameters_text(rows))
    elif what is What.CURVES:
        from rover_ncp.core.files import require_writable, write_atomic
        from sim.paper.curves import curves_png

        require_writable(out)
        write_atomic(out, curves_png(shelf))
        output.result({"picture": str(out)}, str(out))
    else:
        from sim.paper.inside import parking_contributions, parking_time_constants

        if what is What.TIME_CONSTANTS:
            inside = parking_time_constants(shelf)
            output.result(inside, render.time_constants_text(inside))
        else:
            inside = parking_contributions(shelf)
            output.result(inside, render.contributions_text(inside))


def _summary(cell: Any) -> dict[str, Any]:
    fields = ("mean", "std", "plain_mean", "success", "cpu_s", "steps", "ended", "budget")
    return {**cell.name.model_dump(), **{field: getattr(cell, field) for field in fields}}


def _replay(output: Output, shelf: Any, names: list[Any], circuit: Path | None) -> int:
    """Run stored parameters again; exit 1 if a single bit of a return differs."""
    from sim.paper.cell import load_cell
    from sim.paper.train import replay

    differ, count = [], 0
    for name in names:
        path = shelf.find(name)
        if path is None:
            continue
        cell, count = load_cell(path), count + 1
        found = replay(cell, circuit)
        if any(getattr(cell, field) != value for field, value in found.items()):
            differ.append({**name.model_dump(), "stored": cell.mean, "replayed": found["mean"]})
    if not count:
        raise UsageError("there are no such runs to replay; rover-ncp paper status lists the runs that exist")
    output.result({"replayed": count, "differ": differ}, f"{count} runs replayed, {len(differ)} differ")
    return 1 if differ else 0
