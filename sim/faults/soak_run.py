"""The ``soak`` command: shows its progress, reports its findings."""

from pathlib import Path

from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from rover_ncp.core.console import Output
from rover_ncp.core.errors import FileError
from rover_ncp.core.files import require_writable, write_atomic
from sim.faults.soak import Soaked, soak
from sim.faults.soak_report import fields, line, table, verdict
from sim.live.processes import TRUTH

TABLE = "soak.md"


def run_soak(minutes: float, seed: int, out: Path, output: Output, *, overwrite: bool) -> int:
    """Run ``soak_commands.soak``. Raises RoverNcpError when it cannot begin or end."""
    earlier = [*(out / "log").glob(TRUTH), *(out / "drives").glob("*.mcap")]
    if earlier and not overwrite:
        raise FileError(f"{earlier[0]}: exists already; choose another --out, or add --overwrite")
    require_writable(out / TABLE)
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
    said = 0

    def on_round(soaked: Soaked, doing: str) -> None:
        nonlocal said
        bar.update(task, description=doing, completed=soaked.rounds[-1].at_s if soaked.rounds else 0.0)
        for done in soaked.rounds[said:]:
            output.say(line(done))
        said = len(soaked.rounds)

    with bar:
        soaked = soak(minutes * 60.0, seed, out, on_round)
    rows = out / TABLE
    write_atomic(rows, "\n".join(table(soaked)) + "\n")
    wrong = verdict(soaked)
    words = [
        f"{len(soaked.rounds)} faults in {soaked.wall_s / 60:.1f} minutes, load {soaked.load:.1f}; {rows}"
    ]
    if soaked.not_reached:
        words.append("not reached: " + ", ".join(row.key for row in soaked.not_reached))
    words += [f"wrong: {each}" for each in wrong]
    output.result(fields(soaked, seed), "\n".join([*words, "" if wrong else "all is well"]).strip())
    return 1 if wrong else 0
