"""Agents and their learning curves, as a table and as a picture.

Both are a function of the agents alone: same run, same bytes.
"""

import io
from bisect import bisect_right
from collections.abc import Sequence

import numpy as np

from rover_ncp.core.config import StrictModel

_MIN_LOSS = 1e-4


class Agent(StrictModel):
    """An agent at the end of its search, as its file holds it."""

    number: int
    vector: tuple[float, ...]
    """(P,) the best parameters."""
    improvements: tuple[tuple[int, float], ...]
    """(iteration, return) where the best return changed; iteration 0 is the start."""

    @property
    def value(self) -> float:
        """The best return."""
        return self.improvements[-1][1]

    def value_at(self, iteration: int) -> float:
        """Return the best return after ``iteration``."""
        known = bisect_right(self.improvements, iteration, key=lambda change: change[0])
        return self.improvements[known - 1][1]


def curve_iterations(last: int) -> list[int]:
    """Return the iterations a curve shows: those of at most two significant digits, and the last one."""
    shown = [0]
    while shown[-1] < last:
        step = 10 ** max(len(str(shown[-1])) - 2, 0)
        shown.append(min(shown[-1] + step, last))
    return shown


def curve_csv(agents: Sequence[Agent], last: int) -> str:
    """Return the table: iteration, then each agent's best return so far, with all digits."""
    lines = [",".join(["iteration", *(f"agent_{agent.number:02}" for agent in agents)])]
    for iteration in curve_iterations(last):
        lines.append(",".join([str(iteration), *(repr(agent.value_at(iteration)) for agent in agents)]))
    return "\n".join(lines) + "\n"


def curve_png(agents: Sequence[Agent], last: int, title: str) -> bytes:
    """Return a picture of all agents' curves, their median and the best agent, as PNG.

    Returns of a task whose best is 0 differ by orders of magnitude, so the axis is that of −return,
    logarithmic and upside down: higher is better.
    """
    from matplotlib.figure import Figure  # half a second that only the end of a run needs

    iterations = curve_iterations(last)
    losses = -np.array([[agent.value_at(i) for i in iterations] for agent in agents])
    losses = np.maximum(losses, _MIN_LOSS)
    best = int(np.argmin(losses[:, -1]))
    figure = Figure(figsize=(8, 5), dpi=120)
    axes = figure.add_axes((0.1, 0.11, 0.88, 0.81))
    for row, loss in enumerate(losses):
        label = f"{len(losses)} agents" if row == 0 else None
        axes.step(iterations, loss, where="post", color="0.72", linewidth=1, label=label)
    median = np.median(losses, axis=0)
    for loss, color, label in (
        (median, "tab:blue", f"median {-median[-1]:.3f}"),
        (losses[best], "tab:orange", f"agent {agents[best].number:02} {-losses[best, -1]:.3f}"),
    ):
        axes.step(iterations, loss, where="post", color=color, linewidth=2, label=label)
    axes.set_yscale("log")
    axes.invert_yaxis()
    axes.yaxis.set_major_formatter(lambda loss, _: f"−{loss:g}")
    axes.yaxis.set_minor_formatter(lambda loss, _: "")
    axes.grid(alpha=0.3)
    axes.set(xlabel="iteration", ylabel="best return so far", title=title, xlim=(0, max(last, 1)))
    axes.legend(loc="lower right")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})  # a version would change the bytes
    return buffer.getvalue()
