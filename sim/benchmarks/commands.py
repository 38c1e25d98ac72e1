"""The command ``bench``; heavy libraries load only when it runs."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from rover_ncp.core.console import MOST_SEED, Json, Output, reject
from rover_ncp.core.files import require_writable, write_atomic
from sim.learn.search.strategies import SearchName


class What(StrEnum):
    """Measurements of the benchmark."""

    TRAIN = "train"
    SEARCH = "search"
    DEPLOY = "deploy"
    CIRCUIT = "circuit"


def bench(
    what: Annotated[
        What,
        typer.Argument(
            help="train: its speed. search: the returns it reaches. deploy: its response time. circuit: the "
            "solver's cost by size."
        ),
    ],
    *,
    iterations: Annotated[
        int | None,
        typer.Option(
            min=1, max=10**9, help="Iterations of each agent.", show_default="500 for train, 20000 for search"
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, max=MOST_SEED, help="search: root seed.", show_default="0"),
    ] = None,
    agents: Annotated[
        int | None, typer.Option(min=1, max=1000, help="search: agents of each.", show_default="12")
    ] = None,
    search: Annotated[
        SearchName | None, typer.Option(help="search: this one alone.", show_default="all")
    ] = None,
    csv: Annotated[
        Path | None, typer.Option(help="search: write every agent's returns here.", show_default=False)
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            min=2.0,
            max=86_400.0,
            help="deploy: duration in s of each rate's measurement.",
            show_default="60",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Measure the training's speed, the returns of each search, or the driver's response time.

    train measures episodes and iterations per second, on one core and on all, against the plain environment
    of a single rover, what a substep costs alone and as a lane, and where the time goes. Speeds of one core
    are in CPU time. search trains with every strategy from the same root seed and counts the agents that pass
    a return of -0.1 (it parks), -0.05 and -0.03; with all its iterations that takes minutes.

    deploy measures the time from an odometry sample to its command at 10, 50 and 100 samples a second, beside
    a bare round trip of the same bytes, the ticks' jitter and the share of a core. It also measures the
    circuit's part of that time, and whether the whole driver can run 500 times a second.

    circuit measures the CPU time of a tick, ten substeps, of circuits of 24 to 192 neurons and 60 to 480
    synapses.

        rover-ncp bench train --json
        rover-ncp bench deploy --seconds 10
        rover-ncp bench search --seed 1 --csv returns.csv
    """
    output = Output(json)
    if what is not What.DEPLOY:
        reject("is for deploy", seconds=seconds)
    if what is not What.SEARCH:
        reject("is for search", seed=seed, agents=agents, search=search, csv=csv)
    if what in {What.DEPLOY, What.CIRCUIT}:
        reject("is for train and search", iterations=iterations)
    if csv is not None:
        require_writable(csv)
    if what is What.DEPLOY:
        from sim.benchmarks.deploy import bench_deploy

        fields = bench_deploy(seconds or 60.0, output.say)
        slow = fields["rates"][0]["above_bare_ms"]["p99"]
        output.result(fields, f"10 Hz: the 99th percentile is {slow:.2f} ms above the bare half round trip")
        return
    if what is What.CIRCUIT:
        from sim.benchmarks.train import bench_circuit

        fields = bench_circuit()
        parts = "{fixed_us:.1f} µs, {neuron_us:.3f} µs a neuron and {synapse_us:.3f} µs a synapse".format(
            **fields
        )
        output.result(fields, f"a tick takes {parts}; at most {fields['most_off']:.0%} off")
        return
    if what is What.TRAIN:
        from sim.benchmarks.train import bench_train

        fields = bench_train(iterations or 2_500, output.say)
        output.result(fields, f"peak memory {fields['peak_memory_mb']:.0f} MB")
        return

    from sim.benchmarks.search import bench_search, returns_table

    budget, seed, agents = iterations or 20_000, seed or 0, agents or 12
    strategies = [search.value] if search is not None else list(SearchName)
    found, trained = bench_search(seed, agents, budget, output.say, strategies)
    if csv is not None:
        write_atomic(csv, returns_table(trained, seed, budget))
    output.result(found, f"{agents} agents, {budget} iterations each")
