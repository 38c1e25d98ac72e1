"""Claims about the circuit itself: its size, its bounds, and what the trained parking circuits show.

Their figures are computed from the wiring, from stored parameters and from drives of the parking circuits.
"""

from collections.abc import Iterator

import numpy as np

from deploy.report.interpretation import PUBLISHED_SIGNS, contributions
from rover_ncp.circuit.circuit import BOUNDS, Bounds, ParameterKind, SynapseKind
from rover_ncp.circuit.policy import Policy
from sim.learn.engine.rollout import Rollout
from sim.learn.random_circuit import random_circuit
from sim.paper.agents import build_agent
from sim.paper.claims import Claim, Finding, share_finding
from sim.paper.interpretation import (
    BENCHMARK_TIME_CONSTANTS_S,
    benchmark_time_constants,
    drives,
    parking_contributions,
    parking_time_constants,
)
from sim.paper.results import ResultStore
from sim.paper.tasks import TASKS

Drives = list[tuple[Policy, Rollout]]
PUBLISHED_BOUNDS = {
    ParameterKind.CAPACITANCE: Bounds(0.001, 1.0, "F"),
    ParameterKind.LEAK: Bounds(0.05, 5.0, "S"),
    ParameterKind.LEAK_POTENTIAL: Bounds(-90.0, 0.0, "mV"),
    ParameterKind.SIGMA: Bounds(0.05, 0.5, "1/mV"),
    ParameterKind.WEIGHT: Bounds(0.0, 3.0, "S"),
}
"""The paper's, of Tables I, S2 and S5."""
_CRITERION = "the criterion is that two ranges overlap; its limit is that a wide range overlaps nearly any"
_LITERAL = 0.5
"""The threshold of Definition 1 as its words read: more than half of the other side's count."""


def circuit_claims(store: ResultStore) -> Iterator[Claim]:
    """Yield all claims about circuits. Raises FileError, and UsageError without a trained parking circuit."""
    found = drives(store)
    yield from _structure(store)
    yield from _bounds(found)
    yield from _dynamics(store)
    yield from _signs(store, found)
    yield from _parking(store, found)
    yield from _settings()


def _structure(store: ResultStore) -> Iterator[Claim]:
    command = "rover-ncp paper parameters"
    circuit, parking = TASKS["pendulum"].circuit(), TASKS["parking"].circuit()
    sizes = [(each.size, each.synapse_count) for each in (circuit, parking)]
    yield Claim(
        "size",
        "11 neurons and 28 synapses; parking adds a neuron and two synapses",
        "section on the circuit, supplement on parking",
        Finding.REPRODUCED if sizes == [(11, 28), (12, 30)] else Finding.NOT_REPRODUCED,
        "; ".join(f"{neurons} neurons, {synapses} synapses" for neurons, synapses in sizes),
        command,
    )
    sparsity = 1.0 - circuit.synapse_count / circuit.size**2
    yield Claim(
        "sparsity",
        "the circuit is 77 % sparse, networks 0 %",
        "Table IV",
        Finding.REPRODUCED if round(sparsity, 2) == 0.77 else Finding.NOT_REPRODUCED,
        f"{sparsity:.1%} of {circuit.size} x {circuit.size} possible synapses are absent",
        command,
    )
    for task in ("pendulum", "half-cheetah", "parking"):
        counts = {
            agent: build_agent(TASKS[task], agent, 0).layout().size for agent in ("circuit", "mlp", "lstm")
        }
        least = min(counts, key=counts.__getitem__)
        ahead = counts["circuit"] < counts["lstm"]
        verdict = Finding.DIFFERENCE if ahead else Finding.NOT_REPRODUCED
        yield Claim(
            f"parameters-{task}",
            f"{TASKS[task].title}: the circuit has fewer parameters than networks of its size",
            "abstract, Table IV",
            Finding.REPRODUCED if least == "circuit" else verdict,
            ", ".join(f"{agent} {count}" for agent, count in counts.items()),
            command,
            "" if least == "circuit" else "an MLP of eleven cells has fewer than the circuit",
        )
    wirings = [
        random_circuit(run.name.seed, circuit.neurons, circuit.synapse_count)
        for run in store.results("pendulum", "random")
    ]
    counts_of_random = sorted({wiring.synapse_count for wiring in wirings})
    yield Claim(
        "random-size",
        "random circuits have the size and the sparsity of the circuit",
        "Table II",
        Finding.DIFFERENCE,
        f"{', '.join(map(str, counts_of_random))} synapses in {len(wirings)} wirings",
        "rover-ncp paper random-circuits",
        "the published generator drops duplicates, which leaves 23 to 28 synapses; ours keeps exactly 28",
    )
    gaps = np.flatnonzero(circuit.kind == SynapseKind.GAP).tolist()
    driven = _policy("pendulum").sensing.neurons
    from_sensory = [gap for gap in gaps if circuit.neurons[circuit.source[gap]] in driven]
    yield Claim(
        "gap-junctions",
        "a gap junction conducts in both directions",
        "equation 1",
        Finding.DIFFERENCE,
        f"{len(from_sensory)} of {len(gaps)} begin at a sensory neuron: "
        f"{', '.join(map(circuit.label, gaps))}",
        command,
        "ours conduct one way, as the published code's. The criterion is that a junction begins at a sensory "
        "neuron: its input drives it, so that the other direction has no effect. Its limit is this wiring; a "
        "random one may join other neurons",
    )


def _policy(task: str) -> Policy:
    return TASKS[task].policy(TASKS[task].circuit())


def _bounds(found: Drives) -> Iterator[Claim]:
    yield Claim(
        "parameter-bounds",
        "; ".join(f"{kind}: {bounds}" for kind, bounds in PUBLISHED_BOUNDS.items()),
        "Tables I, S2 and S5",
        Finding.REPRODUCED
        if all(BOUNDS[kind] == bounds for kind, bounds in PUBLISHED_BOUNDS.items())
        else Finding.NOT_REPRODUCED,
        "; ".join(f"{kind}: {BOUNDS[kind]}" for kind in PUBLISHED_BOUNDS),
        "rover-ncp paper claims",
        "the bounds are compared; every search clips to them",
    )
    potentials = np.concatenate([drive.potentials.ravel() for _, drive in found])
    low, high = float(potentials.min()), float(potentials.max())
    yield Claim(
        "potentials",
        "every potential stays between -90 and 0 mV",
        "supplement, solver",
        Finding.REPRODUCED if low >= -90.0 and high <= 0.0 else Finding.NOT_REPRODUCED,
        f"{low:.1f} to {high:.1f} mV over the drives of {len(found)} parking circuits",
        "rover-ncp explain parking",
    )


def _dynamics(store: ResultStore) -> Iterator[Claim]:
    rows = parking_time_constants(store)["time_constants_s"]
    same, possible = (
        [row["neuron"] for row in rows if _overlap(row[which], row["published"])] for which in ("best", "all")
    )
    yield Claim(
        "time-constants",
        "time constants of the parking run, neuron by neuron",
        "Table S7",
        share_finding(len(same), len(rows)),
        f"{len(same)} of {len(rows)} ranges of the best circuit meet the paper's ({', '.join(same)}), "
        f"{len(possible)} of all circuits together",
        "rover-ncp paper time-constants",
        _CRITERION,
    )
    for task, published in BENCHMARK_TIME_CONSTANTS_S.items():
        if not store.results(task, "circuit"):
            continue
        ours = benchmark_time_constants(store, task)
        same = [neuron for neuron in published if _overlap(ours[neuron], published[neuron])]
        yield Claim(
            f"time-constants-{task}",
            f"{TASKS[task].title}: time constants of the run, neuron by neuron",
            "Table S7",
            share_finding(len(same), len(published)),
            f"{len(same)} of {len(published)} ranges of the best circuit meet the paper's"
            + (f" ({', '.join(same)})" if same else ""),
            f"rover-ncp explain --task {task}",
            _CRITERION,
        )
    changing = [row["neuron"] for row in rows if row["best"][1] > 1.01 * row["best"][0]]
    yield Claim(
        "varying-time-constants",
        "time constants vary with the activity of the circuit",
        "section on the neuron model, Table S7",
        share_finding(len(changing), len(rows)),
        f"{len(changing)} of {len(rows)} neurons of the best circuit vary by more than 1 %",
        "rover-ncp paper time-constants",
    )


def _signs(store: ResultStore, found: Drives) -> Iterator[Claim]:
    rows = parking_contributions(store)["contributions"]
    runs, command = len(found), "rover-ncp paper contributions"
    for row in rows:
        yield Claim(
            f"sign-{row['source']}-{row['destination']}",
            f"the contribution of {row['source']} to {row['destination']} is {row['published']}",
            "section on interpretability, Definition 1",
            share_finding(row["agree"], runs),
            f"{row['agree']} of {runs} circuits agree; P > 1.5 Q",
            command,
            "" if row["agree"] in (0, runs) else "circuits that park differ among themselves",
        )
    signs = [contributions(policy.circuit.neurons, drive.potentials) for policy, drive in found]
    for source, destination in (("AVA", "RGT"), ("AVB", "LFT")):
        positive = sum(each[source, destination].sign == "positive" for each in signs)
        yield Claim(
            f"command-{source}-{destination}",
            f"{source} drives {destination}",
            "section on interpretability, circuit figure",
            share_finding(positive, runs),
            f"its contribution is positive in {positive} of {runs} circuits",
            command,
        )
    pairs = [each[pair] for each in signs for pair in PUBLISHED_SIGNS]
    both = sum(
        pair.positive > _LITERAL * pair.negative and pair.negative > _LITERAL * pair.positive
        for pair in pairs
    )
    yield Claim(
        "definition-1-literal",
        "a contribution is positive if P is more than half of Q (as the words read)",
        "Definition 1",
        Finding.NOT_REPRODUCED if both else Finding.REPRODUCED,
        f"{both} of {len(pairs)} pairs are positive and antagonistic at once",
        command,
        "so we read it as P larger than Q by more than half of Q" if both else "",
    )


def _parking(store: ResultStore, found: Drives) -> Iterator[Claim]:
    ends = [drive.verdict for _, drive in found]
    rms = sorted(drive.rms_m for _, drive in found)
    yield Claim(
        "trajectory",
        "the rover follows the checkpoints and parks",
        "section on parking, trajectory figure",
        Finding.REPRODUCED if all(end.parked for end in ends) else Finding.DIFFERENCE,
        f"{sum(end.parked for end in ends)} of {len(ends)} park; root mean square distance to the "
        f"checkpoints {100 * rms[0]:.1f} to {100 * rms[-1]:.1f} cm",
        "rover-ncp explain parking",
    )
    four = store.results("four-dof", "circuit")
    parked = sum(result.success for result in four)
    yield Claim(
        "four-dof",
        "a rover that can also drive backward learns to park",
        "supplement 6",
        Finding.DIFFERENCE if parked == len(four) > 0 else Finding.NOT_REPRODUCED,
        f"{parked} of {len(four)} park",
        "rover-ncp paper networks",
        "with our search, up to 100,000 candidates, and standing still asked for",
    )
    for name, figure in (
        ("activity-figure", "each neuron's activity along the trajectory"),
        ("slopes-figure", "histograms of slopes and phase plots of pairs of neurons"),
        ("circuit-figure", "the circuit with its time constants"),
    ):
        yield Claim(
            name,
            f"a figure shows {figure}",
            "figures on interpretability",
            Finding.DIFFERENCE,
            "docs/interpretation",
            "rover-ncp explain parking --out docs/interpretation",
            "drawn for a circuit of ours, whose signs differ from the paper's",
        )


def _settings() -> Iterator[Claim]:
    command = "rover-ncp paper parameters"
    low, high = (_policy("pendulum").motors.low_mV, _policy("pendulum").motors.high_mV)
    yield Claim(
        "motor-range",
        "motor neurons map -70 to -20 mV",
        "supplement, motors",
        Finding.DIFFERENCE,
        f"{low:g} to {high:g} mV",
        command,
        "as the published code, with which the published circuits were trained",
    )
    for task in TASKS.values():
        for signal, published in task.published_ranges:
            sides = dict(next(c for c in _policy(task.name).sensing.channels if c.name == signal).sides)
            yield Claim(
                f"range-{task.name}-{signal}",
                f"{task.title}: the range of {signal} is {published}",
                "Table S6",
                Finding.DIFFERENCE,
                f"±{max(sides.values()):g}",
                command,
                "ours are those with which the published circuit solves the task",
            )
    yield Claim(
        "settings",
        "iterations, horizon, rollouts and worst rollouts of each experiment",
        "Table S4",
        Finding.DIFFERENCE,
        "; ".join(
            f"{task.name} {task.settings.iterations}, {task.horizon}, {task.settings.rollouts}, "
            f"{task.settings.worst}"
            for task in TASKS.values()
        ),
        command,
        "mountain car ends after 999 steps, as Gymnasium's; half-cheetah's, which the table lacks, are the "
        "published code's",
    )
    neurons = {
        task: "; ".join(
            f"{channel.name} {', '.join(neuron for neuron, _ in channel.sides)}"
            for channel in (*_policy(task).sensing.channels, *_policy(task).motors.channels)
        )
        for task in ("pendulum", "mountain-car", "cart-pole", "parking")
    }
    yield Claim(
        "neurons",
        "the neurons of each variable of the environment",
        "Table S3",
        Finding.DIFFERENCE,
        "; ".join(f"{task}: {pairs}" for task, pairs in neurons.items()),
        command,
        "on parking the table names FWD and REV for both speeds; LFT, RGT and FWD are the published code's",
    )


def _overlap(ours: tuple[float, float], theirs: tuple[float, float]) -> bool:
    return ours[0] <= theirs[1] and theirs[0] <= ours[1]
