"""Searches of the paper's tasks: the paper's own with their references, and the faster default ones."""
