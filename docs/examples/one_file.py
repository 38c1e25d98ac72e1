"""The whole idea in one file: a worm's circuit learns to park a rover.

Hasani et al., "Can a Compact Neuronal Circuit Policy be Re-purposed to Learn Simple Robotic Control?" (ICRA
2020, https://doi.org/10.48550/arXiv.1809.04423), take the circuit with which the worm C. elegans draws back
from a touch, connect its touch neurons to the pose of a rover and its command neurons to the rover's motors,
and let a random search find the parameters that park the rover.

This file needs numpy, pymunk, matplotlib and pyyaml, and imports nothing of rover-ncp:

    python one_file.py --iterations 2000     # train a circuit and draw its drive (minutes)
    python one_file.py --policy POLICY.yaml   # draw the drive of a trained parking circuit

rover-ncp does the same about a hundred times faster, with a better search, and drives real robots with it.
Units: s, m, rad, mV; conductances in S, capacitances in F, sigma in 1/mV.
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

# Kind of synapse, source, destination, weight before the search. The wiring never changes.
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
IS_GAP = np.array([kind == "gap" for kind, *_ in SYNAPSES])
REVERSAL_MV = np.array([0.0 if kind == "ex" else -90.0 for kind, *_ in SYNAPSES])
MIDPOINT_MV = -40.0  # at this presynaptic potential a chemical synapse is half open

# What the search changes: lower bound, upper bound, value before the search, how many.
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
    A chemical synapse opens with its presynaptic potential and pulls V toward its reversal potential E. A gap
    junction pulls V toward the presynaptic potential. The step is implicit in V and explicit in everything
    else. Every new potential is therefore a weighted mean of potentials that are within bounds.
    """
    presynaptic = potentials[SOURCE]
    opened = 1.0 / (1.0 + np.exp(-circuit["sigma"] * (presynaptic - MIDPOINT_MV)))
    conductance = circuit["weight"] * np.where(IS_GAP, 1.0, opened)
    pull = np.where(IS_GAP, presynaptic, REVERSAL_MV)
    c_per_dt = circuit["capacitance"] / dt
    numerator = (
        c_per_dt * potentials + circuit["leak"] * circuit["leak_potential"] + INTO @ (conductance * pull)
    )
    return numerator / (c_per_dt + circuit["leak"] + INTO @ conductance)


# 2. From the pose to the touch neurons, from the motor neurons to the wheels.

SENSORY = [
    NEURONS.index(name) for name in ("PVD", "PLM", "ALM", "AVM")
]  # driven by x, y, heading, start signal
LEFT, RIGHT, FORWARD = (NEURONS.index(name) for name in ("LFT", "RGT", "FWD"))
V_MAX, OMEGA_MAX = 0.16, 0.18
DT, SUBSTEPS = 0.01, 10  # a control tick is ten steps of circuit and rover
TICK = DT * SUBSTEPS


def control_tick(circuit: Circuit, potentials: np.ndarray, observation: np.ndarray) -> np.ndarray:
    """Return the potentials after a tick in which the touch neurons are driven by ``observation`` (4,).

    0 to 1 (m, m, rad, signal) becomes -70 to -20 mV.
    """
    touch = -70.0 + 50.0 * np.clip(observation, 0.0, 1.0)
    potentials = potentials.copy()
    potentials[SENSORY] = touch
    for _ in range(SUBSTEPS):
        potentials = circuit_step(circuit, potentials, DT)
        potentials[SENSORY] = touch  # nothing feeds a touch neuron
    return potentials


def motor_command(potentials: np.ndarray) -> tuple[float, float]:
    """Return (v, omega) in m/s and rad/s: -60 to -20 mV of a motor neuron becomes 0 to full speed."""
    share = np.clip((potentials + 60.0) / 40.0, 0.0, 1.0)
    return V_MAX * share[FORWARD], OMEGA_MAX * (share[LEFT] - share[RIGHT])


# 3. The rover: a box on pymunk whose wheels accelerate it.


class Rover:
    """A Pioneer 3-AT that obeys a command after a delay and with limited acceleration."""

    ACCEL, ALPHA = 0.31, 1.25  # m/s², rad/s²
    DELAY_V, DELAY_OMEGA = 15, 10  # substeps of 0.01 s

    def __init__(self) -> None:
        self.space = pymunk.Space()
        size = (0.626, 0.505)
        self.body = pymunk.Body(12.0, pymunk.moment_for_box(12.0, size))
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
        # The body's velocity still points where the rover headed before it turned in the last substep.
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
# Deadline in s, then the pose that the rover should have at it: forward, left, forward, right, stop.
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
    """What happened in T ticks."""

    total: float
    """The return: minus the sum of squared distances to the checkpoints (1 rad counts as 1 m)."""
    poses: np.ndarray
    """(T + 1, 3), the first one the start."""
    potentials: np.ndarray
    """(T, 12) after each tick."""


def drive(circuit: Circuit, to_beat: float = -math.inf) -> Drive:
    """Drive the course, or as much of it as it takes to see that the return stays below ``to_beat``."""
    rover = Rover()
    # One tick at rest before the start signal, whose command is not sent.
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


# 5. The paper's search.

# Noise before the search: changes, deviation. In an iteration: from 0 to a limit of changes, which is first
# this initial limit and grows to this largest one; range of the deviation.
NOISE = {
    "weight": (15, 0.5, 4, 12, 0.01, 0.4),
    "sigma": (10, 0.2, 3, 8, 0.01, 0.05),
    "leak_potential": (8, 8.0, 2, 6, 0.1, 3.0),
    "leak": (8, 0.2, 2, 6, 0.05, 0.5),
    "capacitance": (10, 0.1, 2, 4, 0.01, 0.1),
}


def perturb(circuit: Circuit, name: str, changes: int, deviation: float, random: np.random.Generator) -> None:
    """Add noise to randomly picked entries of one parameter kind, within its bounds."""
    lower, upper, _, count = PARAMETERS[name]
    np.add.at(circuit[name], random.integers(count, size=changes), random.normal(0.0, deviation, changes))
    np.clip(circuit[name], lower, upper, out=circuit[name])


def search(iterations: int, seed: int) -> tuple[Circuit, list[float]]:
    """Return the best circuit and its return after each iteration, by the search of the published code.

    Perturb a few parameters and keep the change if the rover drives better. After 51 failures in a row,
    perturb up to one more entry of each kind; after a success, one fewer.
    """
    random = np.random.default_rng(seed)
    best, failures, widened = untrained(), 0, 0
    for name, (changes, deviation, *_) in NOISE.items():
        perturb(best, name, changes, deviation, random)
    returns = [drive(best).total]
    for _ in range(iterations):
        candidate = {name: values.copy() for name, values in best.items()}
        for name, (_, _, initial, largest, low, high) in NOISE.items():
            changes = random.integers(min(initial + widened, largest), endpoint=True)
            perturb(candidate, name, changes, random.uniform(low, high), random)
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
    circuit = {
        name: np.array(
            [part.get(name, 0.1) for part in data["synapses" if count == len(SYNAPSES) else "neurons"]]
        )
        for name, (_, _, _, count) in PARAMETERS.items()
    }
    ends = [(synapse["source"], synapse["destination"]) for synapse in data["synapses"]]
    if ends != [(source, destination) for _, source, destination, _ in SYNAPSES]:
        raise SystemExit(f"{path}: its circuit has another wiring than the parking circuit of this file")
    return circuit


def draw(run: Drive, path: str) -> None:
    """Draw the rover's way with the checkpoints, and the potentials of all neurons over time."""
    import matplotlib.pyplot as plt

    figure, (way, neurons) = plt.subplots(1, 2, figsize=(12, 5), layout="constrained")
    way.plot(*run.poses[:, :2].T, label="rover")
    way.scatter(*CHECKPOINTS[:, 1:3].T, s=18, color="tab:orange", label="checkpoints", zorder=3)
    way.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title=f"Return {run.total:.3f}")
    way.legend()
    times = TICK * np.arange(1, len(run.potentials) + 1)
    for number, (name, trace) in enumerate(zip(NEURONS, run.potentials.T, strict=True)):
        neurons.plot(
            times, trace, label=name, lw=1.2, color=f"C{number % 10}", ls="-" if number < 10 else "--"
        )
    neurons.axvline(START_SIGNAL_S, color="gray", ls=":", lw=1)
    neurons.set(xlabel="time (s)", ylabel="potential (mV)", title="Neurons; dotted: the start signal")
    neurons.legend(ncols=2, fontsize=7, loc="upper right")
    figure.savefig(path, dpi=120)


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
