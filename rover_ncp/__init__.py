"""rover-ncp: a tiny, explainable neural circuit on a real rover. The shared package, and the Python API.

    import rover_ncp

    runner = rover_ncp.Runner(rover_ncp.load_policy("parking"))
    v, omega = runner.tick([x, y, theta, start])        # every 0.1 s
    result = rover_ncp.train({"agents": 4, "iterations": 2000}, "runs/mine")
    print(rover_ncp.evaluate(result.policy, trials=100, randomize="full").success_rate)

Each name is loaded when it is first used. Errors are those of ``rover_ncp.core.errors``.
"""

from typing import Any

__all__ = ["Runner", "evaluate", "explain", "load_policy", "read_arrays", "train"]


def __getattr__(name: str) -> Any:
    """Load a name of the API through its entry point: this package imports none of those above it."""
    if name in __all__:
        from importlib.metadata import entry_points

        for point in entry_points(group="rover_ncp.api", name=name):
            globals()[name] = point.load()
            return globals()[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
