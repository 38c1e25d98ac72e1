"""The paper's experiments: tasks, controllers, searches, stored runs, and the claims that the runs test.

This folder is no part of the installed project. Run it at the top of a clone::

    python -m paper report
    python -m paper replay
    python -m paper run --budget quick --task parking
    python -m paper.bnn IN.bnn OUT.yaml
"""
