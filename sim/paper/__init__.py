"""The paper's experiments: tasks, agents, a grid of runs, and the claims that the runs test."""

from enum import StrEnum


class BudgetName(StrEnum):
    """Budget of a run, and the search that spends it."""

    PUBLISHED = "published"
    """The paper's iterations and rollouts with the search of its published code."""
    ALGORITHM1 = "algorithm1"
    """The paper's iterations and rollouts with Algorithm 1 as it is printed."""
    GRADIENTS = "gradients"
    """Training by PPO or A2C, for which the paper gives no settings."""
    QUICK = "quick"
    """A few iterations of the published search."""
