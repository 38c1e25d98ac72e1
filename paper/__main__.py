"""The commands; heavy libraries load only when one of them runs."""

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from paper.store import BudgetName, ResultStore
from rover_ncp.core.console import Overwrite
from rover_ncp.core.errors import FileError, RoverNcpError, UsageError
from rover_ncp.core.files import require_writable

app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False)
RESULTS = Path(__file__).parent / "results"
Names = Annotated[list[str] | None, typer.Option(help="Only this; repeatable.", show_default="all")]
Seeds = Annotated[list[int] | None, typer.Option(min=0, help="Only this; repeatable.", show_default="all")]
Results = Annotated[Path, typer.Option(help="Folder of the runs.", show_default="paper/results")]


@app.command()
def run(
    *,
    task: Names = None,
    agent: Names = None,
    seed: Seeds = None,
    budget: Annotated[
        BudgetName,
        typer.Option(
            help="published: the paper's iterations with the search of its code. algorithm1: the same with "
            "the search as printed. default: agents of rover-ncp train, root seed 0. gradients: PPO and A2C. "
            "quick: published, but seconds a run."
        ),
    ] = BudgetName.PUBLISHED,
    results: Results = RESULTS,
    again: Annotated[bool, typer.Option("--again", help="Repeat runs that exist already.")] = False,
    processes: Annotated[
        int | None, typer.Option(min=1, max=1000, help="Runs at once.", show_default="one for each core")
    ] = None,
) -> None:
    """Make the runs that do not exist yet.

    A run is one line of RESULTS/BUDGET/TASK.jsonl: settings, versions, learning curve, trained parameters.

        python -m paper run --task mountain-car --agent circuit --seed 3 --again
    """
    from paper.runs import make_runs, select

    store, names = ResultStore(results), select(task, agent, seed, budget)
    made = set() if again else {result.name for result in store.every()}
    left = [name for name in names if name not in made]
    for path in {store.path(name.task, budget) for name in left}:
        require_writable(path, overwrite=True)
    if left:
        print(f"{len(left)} runs to make; a line for each when it ends", flush=True)
    for result in make_runs(left, store, processes) if left else ():
        outcome = "" if result.success else ", no success"
        score = f"{result.mean:.4g} ± {result.std:.3g}{outcome}"
        print(f"{result.name}: {score} ({result.cpu_s:.0f} s of a core)", flush=True)
    print(f"{len(left)} runs made, {len(names) - len(left)} found")


@app.command()
def replay(
    *,
    task: Names = None,
    agent: Names = None,
    seed: Seeds = None,
    budget: Annotated[
        BudgetName | None, typer.Option(help="Only runs of this budget.", show_default="all")
    ] = None,
    results: Results = RESULTS,
) -> None:
    """Score the parameters of stored runs again; exit 1 if a verdict or a return differs.

    python -m paper replay --task mountain-car
    """
    from paper.runs import agrees
    from paper.runs import replay as score_again

    wanted = {"task": task, "agent": agent, "seed": seed, "budget": budget and [budget]}
    chosen = [
        result
        for result in ResultStore(results).every()
        if all(values is None or getattr(result.name, field) in values for field, values in wanted.items())
    ]
    if not chosen:
        raise UsageError(f"{results}: has no such runs to replay")
    exact = differ = 0
    for result in chosen:
        found = score_again(result)
        exact += found == result.score
        if not agrees(result, found):
            differ += 1
            print(f"{result.name}: stored {result.mean!r}, replayed {found.mean!r}", flush=True)
    print(f"{len(chosen)} runs replayed, {exact} to the last bit, {differ} differ")
    raise typer.Exit(1 if differ else 0)


@app.command()
def report(
    *,
    results: Results = RESULTS,
    long: Annotated[bool, typer.Option("--long", help="Runs, and the tables behind claims.")] = False,
) -> None:
    """Report the paper's claims, and whether the stored runs reproduce them.

    Without --long it prints the first part of docs/paper.md.
    """
    from paper.report import long_report, short_report

    if not results.is_dir():
        raise FileError(f"{results}: no such folder")
    print((long_report if long else short_report)(ResultStore(results)))


@app.command()
def bnn(
    source: Annotated[Path, typer.Argument(metavar="IN.bnn", help="Circuit in the published format.")],
    out: Annotated[Path, typer.Argument(metavar="OUT.yaml", help="Policy or circuit file to write.")],
    overwrite: Overwrite = False,
) -> None:
    """Convert a published circuit into a policy file, or a circuit file."""
    from paper.bnn import convert

    convert(source, out, overwrite=overwrite)


if __name__ == "__main__":
    # For the processes of ``run``: for matrices as small as these, the threads of BLAS only wait.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        app(prog_name="python -m paper")
    except RoverNcpError as error:
        print(f"paper: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
