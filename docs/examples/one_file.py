"""The whole idea in one file: a worm's circuit learns to park a rover.

Hasani et al., "Can a Compact Neuronal Circuit Policy be Re-purposed to Learn Simple Robotic Control?" (ICRA
2020, https://doi.org/10.48550/arXiv.1809.04423), take the circuit with which the worm C. elegans draws back
from a touch, connect its touch neurons to the pose of a rover and its command neurons to the rover's motors,
and let a random search find the parameters that park the rover.

This file needs numpy, pymunk, matplotlib and pyyaml, and imports nothing of rover-ncp:

    python one_file.py --iterations 2000     # train a circuit and draw its drive (minutes)
    python one_file.py --policy POLICY.yaml   # draw the drive of a trained parking circuit

rover-ncp does the same about a hundred times faster, with a better search, and drives real robots with it.
Units: s, m, rad, mV; conductances in S, capacitances in F, sigma in 1/mV. Only ratios of conductances and
capacitances matter: a capacitance over a conductance is a time constant in s.
"""

import argparse
import math
from collections import deque
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pymunk

# 1. The circuit.
#
# PVD, PLM, AVM and ALM are touch sensors. AVA and AVB are command neurons; AVD, PVC and DVA lie between them.
# LFT, RGT and FWD are motor neurons: turn left, turn right, drive forward.

NEURONS = ("PVD", "PLM", "AVA", "AVD", "PVC", "AVB", "AVM", "ALM", "DVA", "LFT", "RGT", "FWD")

# Kind of synapse (inhibitory, excitatory, gap junction), source, destination, weight before the search.
# The wiring is that of the paper's figure 1 and never changes. The weights are the untuned ones of the
# paper's published circuits.
WIRING = """
in PVD AVA 0.60996 | in PLM AVA 0.84907 | ex PVC AVA 1.327515 | in AVB AVA 0.22908 | ex AVD AVA 1.656176
in PLM AVD 0       | ex PVC AVD 0.900241 | in AVA AVD 0.488061 | in AVB AVD 0.443871
gap AVM AVD 1.72995 | in ALM AVD 0
in PVD PVC 0.59057 | gap PLM PVC 0.0388042 | in AVA PVC 0.2 | ex AVD PVC 1.343 | in AVM PVC 0.147041
in ALM PVC 0.70817 | in DVA PVC 0.865243
ex PVC AVB 0.948166 | in AVA AVB 0.58725 | ex AVD AVB 1.53322 | in AVM AVB 0.926931 | in DVA AVB 0.872073
in PVD DVA 0.90098 | in PLM DVA 0.91319 | ex PVC DVA 1.427991
ex AVB LFT 2 | ex AVA RGT 2 | ex AVB FWD 2 | ex AVA FWD 2
"""
SYNAPSES = [row.split() for row in WIRING.replace("\n", "|").split("|") if row.strip()]
SOURCE = np.array([NEURONS.index(source) for _, source, _, _ in SYNAPSES])
INTO = np.zeros((len(NEURONS), len(SYNAPSES)))  # INTO @ values sums over the synapses into each neuron
INTO[[NEURONS.index(destination) for _, _, destination, _ in SYNAPSES], range(len(SYNAPSES))] = 1.0
# A gap junction acts on its destination only: both gap sources are sensory and therefore clamped.
IS_GAP = np.array([kind == "gap" for kind, *_ in SYNAPSES])
# Of chemical synapses. A gap junction has no reversal potential: its value here is not used.
REVERSAL_MV = np.array([0.0 if kind == "ex" else -90.0 for kind, *_ in SYNAPSES])
MIDPOINT_MV = -40.0  # at this presynaptic potential a chemical synapse is half open

# Searched parameters: lower bound, upper bound, value before the search, number of them.
PARAMETERS = {
    "weight": (0.0, 3.0, [float(weight) for *_, weight in SYNAPSES], len(SYNAPSES)),
    "sigma": (0.05, 0.5, 0.1, len(SYNAPSES)),
    "leak_potential": (-90.0, 0.0, -70.0, len(NEURONS)),
    "leak": (0.05, 5.0, 1.0, len(NEURONS)),
    "capacitance": (0.001, 1.0, 0.05, len(NEURONS)),
}
Circuit = dict[str, np.ndarray]  # one array for each of PARAMETERS


def untrained() -> Circuit:
    """Return the parameters before the search."""
    return {name: np.broadcast_to(start, count).copy() for name, (_, _, start, count) in PARAMETERS.items()}


def circuit_step(circuit: Circuit, potentials: np.ndarray, dt: float) -> np.ndarray:
    """Return the potentials (12,) one hybrid Euler step later.

    A neuron is a leaky capacitor: C dV/dt = G (E_leak - V) + the sum over its synapses of g (E - V).
    A chemical synapse opens with its presynaptic potential, and E is its reversal potential. For a gap
    junction, E is the presynaptic potential. The step is implicit in V and explicit in everything else. Every
    new potential is therefore a weighted mean of potentials that are within bounds.
    """
    presynaptic = potentials[SOURCE]
    opened = 1.0 / (1.0 + np.exp(-circuit["sigma"] * (presynaptic - MIDPOINT_MV)))
    conductance = circuit["weight"] * np.where(IS_GAP, 1.0, opened)
    target = np.where(IS_GAP, presynaptic, REVERSAL_MV)
    c_per_dt = circuit["capacitance"] / dt
    numerator = (
        c_per_dt * potentials + circuit["leak"] * circuit["leak_potential"] + INTO @ (conductance * target)
    )
    return numerator / (c_per_dt + circuit["leak"] + INTO @ conductance)


# 2. From the pose to the touch neurons, from the motor neurons to the wheels.

# Sensory neurons of x, y, heading and start signal, in this order.
SENSORY = [NEURONS.index(name) for name in ("PVD", "PLM", "ALM", "AVM")]
LEFT, RIGHT, FORWARD = (NEURONS.index(name) for name in ("LFT", "RGT", "FWD"))
V_MAX, OMEGA_MAX = 0.16, 0.18  # m/s, rad/s: full speed in the paper's parking task
DT, SUBSTEPS = 0.01, 10  # a control tick is ten steps of circuit and rover
TICK = DT * SUBSTEPS


def control_tick(circuit: Circuit, potentials: np.ndarray, observation: np.ndarray) -> np.ndarray:
    """Return the potentials after a tick with the touch neurons clamped to ``observation`` (4,).

    0 to 1 (m, m, rad, signal) becomes -70 to -20 mV. The circuit senses no negative x, y or heading, and none
    above 1: a heading of 1.04 rad, which the course has, looks like 1 rad.
    """
    touch = -70.0 + 50.0 * np.clip(observation, 0.0, 1.0)
    potentials = potentials.copy()
    potentials[SENSORY] = touch
    for _ in range(SUBSTEPS):
        potentials = circuit_step(circuit, potentials, DT)
        potentials[SENSORY] = touch  # clamped: no synapse ends at a touch neuron, but its leak would move it
    return potentials


def motor_command(potentials: np.ndarray) -> tuple[float, float]:
    """Return (v, omega) in m/s and rad/s: -60 to -20 mV of a motor neuron becomes 0 to full speed."""
    share = np.clip((potentials + 60.0) / 40.0, 0.0, 1.0)
    return V_MAX * share[FORWARD], OMEGA_MAX * (share[LEFT] - share[RIGHT])


# 3. The rover: a box on pymunk whose wheels accelerate it.
#
# Nothing collides on this course. pymunk moves the box because rover-ncp uses it, also for obstacles: both
# programs compute the same drive.


class Rover:
    """A Pioneer 3-AT that obeys a command after a delay and with limited acceleration."""

    # As in the parking simulator of the paper.
    ACCEL, ALPHA = 0.31, 1.25  # m/s², rad/s²
    DELAY_V, DELAY_OMEGA = 15, 10  # substeps of 0.01 s

    def __init__(self) -> None:
        self.space = pymunk.Space()
        mass, size = 12.0, (0.626, 0.505)  # kg; length and width in m
        self.body = pymunk.Body(mass, pymunk.moment_for_box(mass, size))
        self.space.add(self.body, pymunk.Poly.create_box(self.body, size))
        self.v_queue = deque([0.0] * self.DELAY_V)
        self.omega_queue = deque([0.0] * self.DELAY_OMEGA)

    @property
    def pose(self) -> tuple[float, float, float]:
        """x, y, heading in m, m, rad."""
        return (*self.body.position, self.body.angle)

    def substep(self, v: float, omega: float) -> None:
        """Advance by 0.01 s under the command (v, omega)."""
        self.v_queue.append(v)
        self.omega_queue.append(omega)
        body = self.body
        # pymunk turned the body after it set the velocity, so undo that turn.
        heading = body.angle - body.angular_velocity * DT
        speed = body.velocity.x * math.cos(heading) + body.velocity.y * math.sin(heading)
        speed = approach(speed, self.v_queue.popleft(), self.ACCEL * DT)
        # Wheels do not roll sideways: the velocity follows the heading.
        body.velocity = (speed * math.cos(body.angle), speed * math.sin(body.angle))
        body.angular_velocity = approach(body.angular_velocity, self.omega_queue.popleft(), self.ALPHA * DT)
        self.space.step(DT)


def approach(value: float, target: float, limit: float) -> float:
    """Return ``value`` moved toward ``target`` by at most ``limit``."""
    return min(max(target, value - limit), value + limit)


# 4. The task: parallel parking by checkpoints.

START_SIGNAL_S, HORIZON_S = 3.0, 32.0
# Deadline in s, then the pose that the rover should have at it. Source: the paper's published parking code.
# Stand still for 3 s, curve left to 1.04 rad, curve right back to 0, stop.
CHECKPOINTS = np.array(
    [
        *((t, 0, 0, 0) for t in (0.0, 1.01, 2.02, 3.03)),
        (4.04, 0.0483167, 0.00357653, 0.130125),
        (5.05002, 0.125534, 0.0207081, 0.308325),
        (6.06004, 0.206234, 0.0554402, 0.506325),
        (7.07007, 0.271758, 0.0997427, 0.684525),
        (8.08009, 0.328391, 0.154958, 0.862725),
        (9.09011, 0.37434, 0.239338, 1.04092),
        (10.1001, 0.415491, 0.30939, 0.945175),
        (11.1102, 0.473668, 0.382773, 0.747175),
        (12.1202, 0.536202, 0.4301204, 0.568975),
        (13.1302, 0.606331, 0.527783, 0.390775),
        (14.1402, 0.681833, 0.561352, 0.212575),
        (15.1503, 0.760318, 0.571164, 0.03),
        *((t, 0.781439, 0.571493, 0) for t in (16.1603, 17.1703, 18.1803, 19.1903, 23.0, 32.0)),
    ]
)


class Drive(NamedTuple):
    """Record of one drive of T ticks."""

    total: float
    """Return: minus the sum of squared distances to the checkpoints (1 rad counts as 1 m)."""
    poses: np.ndarray
    """(T + 1, 3); the first row is the start."""
    potentials: np.ndarray
    """(T, 12) after each tick."""


def drive(circuit: Circuit, to_beat: float = -math.inf) -> Drive:
    """Drive the course; end early once the return cannot exceed ``to_beat``."""
    rover = Rover()
    # Run one tick with zero input and discard its command.
    potentials = control_tick(circuit, np.full(len(NEURONS), -70.0), np.zeros(4))
    poses, trace, total, due = [rover.pose], [], 0.0, 0
    for tick in range(round(HORIZON_S / TICK)):
        signal = float(tick * TICK >= START_SIGNAL_S - 1e-9)
        potentials = control_tick(circuit, potentials, np.array([*rover.pose, signal]))
        for _ in range(SUBSTEPS):
            rover.substep(*motor_command(potentials))
        poses.append(rover.pose)
        trace.append(potentials)
        # At most one checkpoint a tick: the next one whose deadline has come.
        if due < len(CHECKPOINTS) and CHECKPOINTS[due, 0] <= (tick + 1) * TICK + 1e-9:
            total -= float(np.sum((np.array(rover.pose) - CHECKPOINTS[due, 1:]) ** 2))
            due += 1
        if total <= to_beat:
            break  # rewards are never positive
    return Drive(total, np.array(poses), np.array(trace))


# 5. The search of the paper's published parking code.
#
# It differs from the paper's Algorithm 1, whose noise adapts. For tasks with chance, the paper averages the
# worst k of N episodes of a candidate. Parking is deterministic: N = k = 1.


class Noise(NamedTuple):
    """Normal noise of one parameter kind; standard deviations in the kind's unit."""

    start_changes: int
    """Entries changed once before the search, by noise of `start_std`."""
    start_std: float
    changes: int
    """An iteration changes 0 to so many entries; the number grows up to `max_changes`."""
    max_changes: int
    std_low: float
    """An iteration draws its standard deviation between this one and `std_high`."""
    std_high: float


NOISE = {
    "weight": Noise(15, 0.5, 4, 12, 0.01, 0.4),
    "sigma": Noise(10, 0.2, 3, 8, 0.01, 0.05),
    "leak_potential": Noise(8, 8.0, 2, 6, 0.1, 3.0),
    "leak": Noise(8, 0.2, 2, 6, 0.05, 0.5),
    "capacitance": Noise(10, 0.1, 2, 4, 0.01, 0.1),
}


def perturb(circuit: Circuit, name: str, changes: int, std: float, random: np.random.Generator) -> None:
    """Add noise to randomly picked entries of one parameter kind, within its bounds."""
    lower, upper, _, count = PARAMETERS[name]
    np.add.at(circuit[name], random.integers(count, size=changes), random.normal(0.0, std, changes))
    np.clip(circuit[name], lower, upper, out=circuit[name])


def search(iterations: int, seed: int) -> tuple[Circuit, list[float]]:
    """Return the best circuit, and the best return after each iteration.

    Perturb a few parameters and keep the change if the rover drives better. After 51 failures in a row,
    perturb up to one more entry of each kind; after a success, one fewer.
    """
    random = np.random.default_rng(seed)
    best, failures, widened = untrained(), 0, 0
    for name, noise in NOISE.items():
        perturb(best, name, noise.start_changes, noise.start_std, random)
    returns = [drive(best).total]
    for _ in range(iterations):
        candidate = {name: values.copy() for name, values in best.items()}
        for name, noise in NOISE.items():
            changes = random.integers(min(noise.changes + widened, noise.max_changes), endpoint=True)
            perturb(candidate, name, changes, random.uniform(noise.std_low, noise.std_high), random)
        total = drive(candidate, returns[-1]).total
        if total > returns[-1]:
            best, failures, widened = candidate, 0, max(widened - 1, 0)
        elif (failures := failures + 1) == 51:
            failures, widened = 0, min(widened + 1, 8)
        returns.append(max(total, returns[-1]))
    return best, returns


# 6. A picture, and the command line.


def load(path: str) -> Circuit:
    """Return the parameters of a policy file of rover-ncp that has the wiring of this file."""
    import yaml

    with Path(path).open(encoding="utf-8") as file:
        data = yaml.safe_load(file)["circuit"]
    of_neurons = ("leak_potential", "leak", "capacitance")
    circuit = {name: np.array([neuron[name] for neuron in data["neurons"]]) for name in of_neurons}
    circuit["weight"] = np.array([synapse["weight"] for synapse in data["synapses"]])
    # Gap junctions have no sigma in a policy file, and do not use it.
    circuit["sigma"] = np.array([synapse.get("sigma", 0.1) for synapse in data["synapses"]])
    ends = [(synapse["source"], synapse["destination"]) for synapse in data["synapses"]]
    if ends != [(source, destination) for _, source, destination, _ in SYNAPSES]:
        raise SystemExit(f"{path}: its circuit has another wiring than the parking circuit of this file")
    return circuit


def draw(run: Drive, file: str) -> None:
    """Draw the rover's path with the checkpoints, and the potentials of all neurons over time."""
    import matplotlib.pyplot as plt

    figure, (path_axes, neuron_axes) = plt.subplots(1, 2, figsize=(12, 5), layout="constrained")
    path_axes.plot(*run.poses[:, :2].T, label="rover")
    path_axes.scatter(*CHECKPOINTS[:, 1:3].T, s=18, color="tab:orange", label="checkpoints", zorder=3)
    path_axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title=f"Return {run.total:.3f}")
    path_axes.legend()
    times = TICK * np.arange(1, len(run.potentials) + 1)
    for number, (name, trace) in enumerate(zip(NEURONS, run.potentials.T, strict=True)):
        neuron_axes.plot(
            times, trace, label=name, lw=1.2, color=f"C{number % 10}", ls="-" if number < 10 else "--"
        )
    neuron_axes.axvline(START_SIGNAL_S, color="gray", ls=":", lw=1)
    neuron_axes.set(xlabel="time (s)", ylabel="potential (mV)", title="Neurons; dotted: the start signal")
    neuron_axes.legend(ncols=2, fontsize=7, loc="upper right")
    figure.savefig(file, dpi=120)


def main() -> None:
    """Train a circuit or load one, then drive and draw."""
    options = argparse.ArgumentParser(description="A worm's circuit learns to park a rover.")
    options.add_argument("--policy", help="policy file of rover-ncp to drive with, instead of training")
    options.add_argument(
        "--iterations", type=int, default=2000, help="iterations of the search (paper: 20000)"
    )
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--out", default="one_file.png", help="picture to write")
    chosen = options.parse_args()
    if chosen.policy:
        circuit = load(chosen.policy)
    else:
        circuit, returns = search(chosen.iterations, chosen.seed)
        print(
            f"return {returns[0]:.2f} before the search, "
            f"{returns[-1]:.3f} after {chosen.iterations} iterations"
        )
    run = drive(circuit)
    draw(run, chosen.out)
    miss = run.poses[-1] - CHECKPOINTS[-1, 1:]
    print(
        f"return {run.total:.4f}; final position error {1000 * math.hypot(*miss[:2]):.0f} mm, "
        f"final heading error {abs(miss[2]):.3f} rad; picture: {chosen.out}"
    )


if __name__ == "__main__":
    main()
