"""Searches of the paper's tasks: the paper's own, and the faster default ones."""
