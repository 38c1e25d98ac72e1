"""The paper's experiments: tasks, agents, a grid of runs, and the claims that the runs test."""

from enum import StrEnum


class BudgetName(StrEnum):
    """Budget of a run, and the search that spends it."""

    QUICK = "quick"
    DEFAULT = "default"
    PUBLISHED = "published"
    """The paper's iterations and rollouts with the search of its published code."""
    ALGORITHM1 = "algorithm1"
    """The paper's iterations and rollouts with Algorithm 1 as it is printed."""


FAITHFUL = (BudgetName.PUBLISHED, BudgetName.ALGORITHM1)
"""Budgets of the paper's own searches."""
