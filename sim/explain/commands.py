"""Commands of this package; heavy libraries load only when one runs."""

from pathlib import Path
from typing import Annotated

import typer

from rover_ncp.core.console import Json, Output, Overwrite, reject


def explain(
    source: Annotated[
        str,
        typer.Argument(
            help="A policy (name or YAML), or a recording (.mcap) of a drive.", show_default=False
        ),
    ],
    *,
    course: Annotated[
        str | None,
        typer.Option(
            help="Course that a policy drives, by name or YAML file; a recording has its own.",
            show_default="parking",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the page (HTML) and all numbers (JSON)."),
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Explain how a circuit drives: the effect of each neuron, and the parts that the circuit needs.

    The terminal shows a sentence for each phase of the manoeuvre. The page and the JSON add the contribution
    of each neuron to each motor neuron (Definition 1 of the paper, with its counts), the range of each time
    constant, the drive simulated again without each neuron and each synapse, and the sensitivity of the
    return to each parameter.

    A recording is explained on its own course, with the robot of its --model in the simulations. That of a
    docking is refused (2); 'report' explains it. A policy on a course takes half a minute to a minute.

        rover-ncp explain course --course bay --out runs/why
    """
    from rover_ncp.core.files import require_writable
    from sim.explain.explain import explain as explain_source
    from sim.explain.files import NAMES, write

    output = Output(json)
    if out is None:
        reject("needs --out", overwrite=overwrite)
    else:
        for name in NAMES:
            require_writable(out / name, overwrite=overwrite)
    found = explain_source(source, course, on_progress=output.say)
    for number, phase in enumerate(found.findings.phases, 1):
        output.say(f"{number}. {phase.sentence}")
    written = write(found, out) if out is not None else []
    ending = f"{out}/explanation.html" if out is not None else "--out DIR writes the page"
    output.result(found.result(written), ending)
