"""Commands of this package; heavy libraries load only when one runs."""

from pathlib import Path
from typing import Annotated

import typer

from rover_ncp.core.console import Json, Output, Overwrite, reject
from rover_ncp.core.errors import UsageError


def explain(
    source: Annotated[
        str | None,
        typer.Argument(
            help="A policy (name, YAML or .bnn), or a recording (.mcap) of a drive.", show_default=False
        ),
    ] = None,
    *,
    task: Annotated[
        str | None,
        typer.Option(
            help="One of the paper's benchmarks, or a Gymnasium environment by its id, in place of a course.",
            show_default=False,
        ),
    ] = None,
    course: Annotated[
        str | None,
        typer.Option(
            help="Course that a policy drives, by name or YAML file; a recording has its own.",
            show_default="parking",
        ),
    ] = None,
    runs: Annotated[
        Path | None,
        typer.Option(
            help="With --task, without a policy: folder of the runs of 'paper'.",
            show_default="results",
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

    With --task, the phases are those of the circuit's outputs in one episode, and the returns are means of a
    few. Without a policy, the best stored circuit of the paper's benchmark is explained.

    A recording is explained on its own course, with the robot of its --model in the simulations. That of a
    docking is refused (2); 'report' explains it. A policy on a course takes half a minute to a minute.

        rover-ncp explain course --course bay --out runs/why
        rover-ncp explain --task mountain-car --out runs/why-mountain-car
        rover-ncp explain runs/reach/policy.yaml --task my_task:Reach-v0
    """
    from rover_ncp.core.files import require_writable
    from sim.explain.explain import explain as explain_source
    from sim.explain.files import NAMES, write
    from sim.explain.task import RUNS, explain_task

    output = Output(json)
    if out is None:
        reject("needs --out", overwrite=overwrite)
    else:
        for name in NAMES:
            require_writable(out / name, overwrite=overwrite)
    if task is None or source is not None:
        reject("needs --task, without a policy", runs=runs)
    if task is not None:
        if course is not None:
            raise UsageError("--task and --course do not go together")
        found = explain_task(source, task, on_progress=output.say, runs=runs or RUNS)
    elif source is not None:
        found = explain_source(source, course, on_progress=output.say)
    else:
        raise UsageError("explain needs a policy or a recording, or --task with a benchmark of the paper")
    for number, phase in enumerate(found.findings.phases, 1):
        output.say(f"{number}. {phase.sentence}")
    written = write(found, out) if out is not None else []
    ending = f"{out}/explanation.html" if out is not None else "--out DIR writes the page"
    output.result(found.result(written), ending)
