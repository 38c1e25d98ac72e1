"""Results of Hasani et al. (ICRA 2020), for comparison with ours: ten runs a cell."""

from typing import NamedTuple

RUNS = 10


class Reported(NamedTuple):
    """Mean and standard deviation over runs, and which share of them succeeded, where it is given."""

    mean: float
    std: float
    success_rate: float | None = None


_PENDULUM = {
    "lstm": Reported(629.0, 453.1, 0.4),
    "mlp": Reported(1177.5, 31.8, 1.0),
    "circuit": Reported(1168.5, 21.7, 0.9),
    "random": Reported(138.1, 263.2, 0.1),
    "ppo": Reported(1187.4, 51.7),
    "a2c": Reported(1191.2, 45.2),
}
_TABLE = {
    # Its pendulum was Roboschool's; Gymnasium's is the task of today.
    "pendulum": _PENDULUM,
    "roboschool": _PENDULUM,
    "mountain-car": {
        "lstm": Reported(97.5, 1.25, 1.0),
        "mlp": Reported(95.9, 1.86, 1.0),
        "circuit": Reported(91.5, 6.6, 0.8),
        "random": Reported(54.0, 44.6, 0.5),
        "ppo": Reported(94.6, 1.3),
        "a2c": Reported(86.4, 18.3),
    },
    "half-cheetah": {
        "lstm": Reported(1588.9, 353.8, 0.1),
        "mlp": Reported(1271.8, 634.4, 0.0),
        "circuit": Reported(2587.4, 846.8, 0.727),
        "random": Reported(1743.0, 642.3, 0.5),
    },
}
SPARSITY = {"lstm": 0.0, "mlp": 0.0, "circuit": 0.77, "random": 0.77}
"""Share of the possible connections that an agent does without."""


def reported(task: str, agent: str) -> Reported | None:
    """Return the paper's cell, None where it has none."""
    return _TABLE.get(task, {}).get(agent)
