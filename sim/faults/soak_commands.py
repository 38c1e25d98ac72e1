"""The command ``soak``; heavy libraries load only when it runs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rover_ncp.core.console import MOST_SEED, Json, Output, Overwrite

if TYPE_CHECKING:
    from sim.faults.soak import Soaked


def soak(
    *,
    minutes: Annotated[
        float, typer.Option(min=0.5, max=10_080.0, help="Duration in minutes; all rows need about ten.")
    ] = 20.0,
    seed: Annotated[
        int,
        typer.Option(
            min=0, max=MOST_SEED, help="Seed of the order, the drivers and the times of the faults."
        ),
    ] = 0,
    out: Annotated[Path, typer.Option(help="Folder for recordings, table and logs.")] = Path("runs/soak"),
    overwrite: Overwrite = False,
    json: Json = False,
) -> int:
    """Inject every fault of the safety matrix, at random moments, in processes that keep running.

    Mock Pioneer, bridge, links and drivers run as real processes on this machine. For each fault the time to
    standstill is measured, by the rover's true motion, and compared with the bound of docs/safety.md. Then
    the fault is removed and the rover drives again. At the end the rover must stand still. Bridge and mock
    must hold no more memory, threads or sockets than at the beginning. The recordings must hold every message
    that their drivers could receive.

        rover-ncp soak --minutes 20 --seed 1
        rover-ncp soak --minutes 2 --json

    A short soak lists the rows that it did not reach. Exits with 0 if every check passed, else with 1.
    """
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from rover_ncp.core.errors import FileError
    from rover_ncp.core.files import require_writable, write_atomic
    from sim.faults.soak import soak as run_soak
    from sim.faults.soak_report import fields, line, table, verdict
    from sim.live.truth import TRUTH

    output, rows = Output(json), out / "soak.md"
    earlier = [*(out / "log").glob(TRUTH), *(out / "drives").glob("*.mcap")]
    if earlier and not overwrite:
        raise FileError(f"{earlier[0]}: exists already; choose another --out, or add --overwrite")
    require_writable(rows)
    for old in earlier:
        old.unlink()
    bar = Progress(
        TimeElapsedColumn(),
        BarColumn(),
        TextColumn("{task.description}"),
        console=output.console,
        disable=not output.console.is_terminal,
        transient=True,
    )
    task = bar.add_task("starting", total=minutes * 60.0)

    def on_round(soaked: "Soaked", begins: str) -> None:
        last = soaked.rounds[-1] if soaked.rounds else None
        bar.update(task, description=begins, completed=last.at_s if last else 0.0)
        if last and not begins:
            output.say(line(last))

    with bar:
        soaked = run_soak(minutes * 60.0, seed, out, on_round)
    write_atomic(rows, "\n".join(table(soaked)) + "\n")
    wrong = verdict(soaked)
    words = [
        f"{len(soaked.rounds)} faults in {soaked.wall_s / 60:.1f} minutes, load {soaked.load:.1f}; {rows}"
    ]
    if soaked.not_reached:
        words.append("not reached: " + ", ".join(row.key for row in soaked.not_reached))
    words += [f"failed: {each}" for each in wrong] or ["all checks passed"]
    output.result(fields(soaked, seed), "\n".join(words))
    return 1 if wrong else 0
