"""What holds for all tests."""

import gc
import json
import logging
import os
import signal
from pathlib import Path

import pytest
from hypothesis import Phase, settings

from rover_ncp import cli
from rover_ncp.native import core

# Two processes test on two cores: threads for matrices as small as ours would only wait for each other, fifty
# times as long as the work takes. Read by numpy and scipy when they are loaded, also by what the tests start.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# The folder of the native library: with sanitizers (`make sanitize`), or without it (`make test-pure`).
if "NATIVE" in os.environ:
    core._FOLDER = Path(os.environ["NATIVE"])

# A shell that starts the tests in the background has them ignore Ctrl-C, nohup a hang-up, and so would every
# process that they start and then interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, lambda *_: None)

# How long an example takes says more about the machine's other work than about the code.
# `make test` tries a quarter of the examples, always the same, so that its result is about the change.
# `make nightly` loads the profile "full", which draws new ones.
settings.register_profile("full", deadline=None)
settings.register_profile("quick", deadline=None, max_examples=25, derandomize=True)
settings.load_profile("quick")
# Mutants (tests/tools/mutate.py) only have to fail: no one reads their smallest example.
settings.register_profile("mutants", deadline=None, database=None, phases=[Phase.explicit, Phase.generate])

# Files that wait longest for real processes begin first, so that they do not run alone at the end.
LONGEST = ["test_up.py", "test_learn_cluster.py"]


@pytest.fixture(autouse=True)
def log_of_its_own():
    """A bridge or mock that a test runs in this process prints no log of the tests after it."""
    logger = logging.getLogger("rover_ncp")
    handlers, level, last = logger.handlers, logger.level, logging.lastResort
    yield
    logging.lastResort = last
    logger.handlers = handlers
    logger.setLevel(level)


@pytest.fixture
def run_json(capsys):
    """Return a function that runs a command line with --json and returns its exit code and its result."""

    def run_json(line):
        capsys.readouterr()
        code = cli.run([*line.split(), "--json"])
        return code, json.loads(capsys.readouterr().out)

    return run_json


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(items):
    """Mark system tests and those with ROS 2 as long; put the longest files first."""
    for item in items:
        if item.path.parent.name in {"system", "ros"}:
            item.add_marker("long")
    items.sort(key=lambda item: LONGEST.index(item.path.name) if item.path.name in LONGEST else len(LONGEST))


def pytest_collection_finish():
    """Search all modules and tests for garbage once and never again: that takes 9 % of the CPU time."""
    gc.collect()
    gc.freeze()
