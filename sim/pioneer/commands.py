"""Commands of this package; heavy libraries load only when one runs."""

from pathlib import Path
from typing import Annotated

import typer

from rover_ncp.core.options import MOST_SEED, Json, Overwrite


def mock(
    *,
    listen: Annotated[
        str, typer.Option(help="HOST:PORT to wait on; port 0 takes a free one.")
    ] = "127.0.0.1:8101",
    model: Annotated[str, typer.Option(help="p3at, p3at-sh, p3dx or p3dx-sh.")] = "p3at-sh",
    course: Annotated[
        str | None, typer.Option(help="Put this course's obstacles around the rover: a name or a file.")
    ] = None,
    truth: Annotated[
        Path | None, typer.Option(help="Write the rover's true pose to this CSV file, 100 times a second.")
    ] = None,
    overwrite: Overwrite = False,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            help="NAME[=VALUE][@START[-END]], again for more; seconds count from when the motors are first "
            "enabled. mute, deaf, corrupt, drop, noise, freeze-odometry, jump-odometry, bumper, stall, "
            "stop-button, low-battery, reset. '-' reads more of them from standard input, a line each, whose "
            "seconds count from then."
        ),
    ] = None,
    randomize: Annotated[
        str, typer.Option(help="Be a robot nobody measured: ranges none, mild, full, harsh or YAML file.")
    ] = "none",
    trial: Annotated[
        int,
        typer.Option(min=0, max=MOST_SEED, help="Which of them: the one of that number in 'eval --trials'."),
    ] = 0,
    profile: Annotated[
        Path | None,
        typer.Option(help="Be this robot: a rover profile, as 'identify' writes it.", show_default=False),
    ] = None,
    seed: Annotated[
        int,
        typer.Option(min=0, max=MOST_SEED, help="Of the trial, and of which packets random faults damage."),
    ] = 0,
    json: Json = False,
) -> None:
    """Pretend to be a Pioneer: its firmware on a simulated rover, on TCP, in real time.

    Whatever drives a Pioneer can drive this: rover-ncp bridge, ARIA, Player, Soar. The rover starts at the
    origin and obeys delays, acceleration limits, the watchdog and walls as a real one does. When it is ready,
    the line "listening on HOST:PORT" is printed; Ctrl-C or SIGTERM ends it.

    With --randomize it has the errors of one random trial: its delays, gains, noise and start, lost commands
    and a push, for as long as the --course lasts. They begin when the motors are first enabled.
    """
    from sim.pioneer.run import run_mock
    from sim.world.randomization import ranges_for

    run_mock(
        listen=listen,
        model=model,
        course=course,
        truth=truth,
        overwrite=overwrite,
        faults=fault or [],
        seed=seed,
        ranges=ranges_for(randomize, profile),
        trial=trial,
        as_json=json,
    )
