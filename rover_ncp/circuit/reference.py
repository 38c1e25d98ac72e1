"""The circuit's equation in plain Python: the definition of the native library, and its stand-in.

Hasani et al. (ICRA 2020), supplement eq. 1 to 6. A hybrid Euler step of dt takes a neuron with capacitance C,
leak conductance G and leak potential E_L from V to

    (C / dt V + G E_L + sum of g E + sum of w V_j) / (C / dt + G + sum of g + sum of w)

over its chemical synapses, g = w / (1 + exp(-sigma (V_s - mu))), E = 0 or -90 mV, and its gap junctions to
neurons at V_j. All neurons step from the old potentials V, V_s and V_j. The library gives the same bits:
operations have the same order and the exponential is the same polynomial.
"""

import math
from collections.abc import Iterator

from rover_ncp.circuit.circuit import MIDPOINT_MV, REVERSAL_MV, FloatArray, SynapseKind
from rover_ncp.circuit.compiled import LOG2_E, GapJunctions, Program, Synapses

INHIBITORY_MV = REVERSAL_MV[SynapseKind.INHIBITORY]
# 2**f on [-1/2, 1/2], interpolated at Chebyshev nodes in 60 digits: relative error below 5e-18.
EXP2 = (
    *(1.0, 0.6931471805599453, 0.24022650695910158, 0.055504108664821625, 0.009618129107587256),
    *(0.001333355814640647, 0.00015403530463724353, 1.5252733841556773e-05, 1.3215432535912375e-06),
    *(1.0178057087733941e-07, 7.074194297288521e-09, 4.4558179083360645e-10),
)


def exp2(z: float) -> float:
    """Return 2**z for |z| <= 1000 within 2 units in the last place."""
    n = round(z)
    f = z - n
    f2 = f * f
    f4 = f2 * f2
    low, middle, high = (
        (EXP2[i] + EXP2[i + 1] * f) + (EXP2[i + 2] + EXP2[i + 3] * f) * f2 for i in (0, 4, 8)
    )
    return math.ldexp(low + (middle + high * f4) * f4, n)


def clip(value: float, low: float, high: float) -> float:
    """Return the nearest value within [low, high]; for NaN the lower end."""
    return min(max(low, value), high)


def tick(program: Program, vector: FloatArray, *state: FloatArray) -> None:
    """Advance the potentials (n, 1) in mV by a control tick for an observation (inputs, 1).

    The outputs (o, 1), the last array of ``state``, are written; ``vector`` (P,) holds the parameters.
    """
    potentials, observation, outputs = state
    w, v, seen = vector.tolist(), potentials[:, 0].tolist(), observation[:, 0].tolist()
    for neuron, channel, base, gain, lower, upper in zip(*program.sensors, strict=True):
        value = 0.0 if program.input_layer_at.size else seen[channel]
        if program.input_layer_at.size:
            for at, number, reach in zip(
                program.input_layer_at[channel], seen, program.input_range, strict=True
            ):
                value += w[at] / reach * number
        v[neuron] = clip(base + gain * value, lower, upper)
    fixed = []  # over a tick: the currents and conductances of leak, gap junctions and input synapses
    for d, (_, leak_potential, leak, capacitance) in enumerate(zip(*program.integrated, strict=True)):
        rate = w[capacitance] / program.dt_s
        current, total = w[leak] * w[leak_potential], rate + w[leak]
        for gaps in (program.input_gaps, program.recurrent_gaps):
            for weight, _ in _junctions(gaps, d, w):
                total += weight
        current, total = _add_synapses(program.input_synapses, d, w, v, (current, total))
        for weight, source in _junctions(program.input_gaps, d, w):
            current += weight * v[source]
        fixed.append((rate, current, total))
    for _ in range(program.substeps):
        old = v.copy()
        for d, (neuron, (rate, current, total)) in enumerate(
            zip(program.integrated.neuron, fixed, strict=True)
        ):
            driven = current + rate * old[neuron]
            driven, conductance = _add_synapses(program.recurrent_synapses, d, w, old, (driven, total))
            for weight, source in _junctions(program.recurrent_gaps, d, w):
                driven += weight * old[source]
            v[neuron] = driven / conductance
    potentials[:, 0] = v
    outputs[:, 0] = _outputs(program, w, v)


def _junctions(gaps: GapJunctions, d: int, w: list[float]) -> Iterator[tuple[float, int]]:
    """Yield weight and source of a neuron's gap junctions."""
    for s in range(int(gaps.first[d]), int(gaps.first[d + 1])):
        yield w[gaps.weight_at[s]], int(gaps.source[s])


def _add_synapses(
    synapses: Synapses, d: int, w: list[float], v: list[float], sums: tuple[float, float]
) -> tuple[float, float]:
    """Return current and conductance with those of a neuron's chemical synapses added."""
    current, total = sums
    for s in range(int(synapses.first[d]), int(synapses.first[d + 1])):
        slope = -LOG2_E * w[synapses.sigma_at[s]]
        gate = w[synapses.weight_at[s]] / (1.0 + exp2(slope * (v[synapses.source[s]] - MIDPOINT_MV)))
        total += gate
        if s >= synapses.first_inhibitory[d]:
            current += INHIBITORY_MV * gate
    return current, total


def _outputs(program: Program, w: list[float], v: list[float]) -> list[float]:
    """Read the motor neurons."""
    values = [0.0] * (1 + max(program.motors.channel, default=0))
    for neuron, channel, end in zip(*program.motors, strict=True):
        values[channel] += end * clip((v[neuron] - program.motor_low) * program.motor_scale, 0.0, 1.0)
    if not program.output_layer_at.size:
        return values
    sums = []
    for row in program.output_layer_at:
        total = 0.0
        for value, at in zip(values, row, strict=True):
            total += w[at] * value
        sums.append(total)
    if not len(program.output_limit):
        return sums
    return [limit * clip(total, -1.0, 1.0) for limit, total in zip(program.output_limit, sums, strict=True)]
