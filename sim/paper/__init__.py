"""The paper's experiments: tasks, agents, a grid of runs, and the tables made of it."""

from enum import StrEnum


class BudgetName(StrEnum):
    """Budget of a run, and the search that spends it."""

    QUICK = "quick"
    DEFAULT = "default"
    PUBLISHED = "published"
    """The paper's iterations and rollouts with the search of its published code; the mean of the worst k."""
    PUBLISHED_MEAN = "published-mean"
    """The same with the mean of all N rollouts."""
    ALGORITHM1 = "algorithm1"
    """The paper's iterations and rollouts with Algorithm 1 as it is printed; the mean of the worst k."""


FAITHFUL = (BudgetName.PUBLISHED, BudgetName.PUBLISHED_MEAN, BudgetName.ALGORITHM1)
"""Budgets of the paper's own searches."""
