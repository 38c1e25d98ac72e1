"""The paper's experiments: tasks, controllers, searches, stored runs, and the claims that the runs test.

This folder is no part of the installed project. Run ``python -m paper --help`` at the top of a clone.
"""
