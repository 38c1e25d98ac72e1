"""The paper's experiments: tasks, agents, a grid of runs, and the tables made of it."""

from enum import StrEnum


class BudgetName(StrEnum):
    """Budget of a run."""

    QUICK = "quick"
    DEFAULT = "default"
    PUBLISHED = "published"
