"""A pool of processes in a program that has children of its own."""

import multiprocessing
import os
import signal
import time

import pytest

from sim.learn.workers import WorkerDied, process_pool, starting_processes


@pytest.fixture
def child():
    """A child of the host program."""
    process = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(600.0,))
    process.start()
    yield process
    process.kill()
    process.join()


def test_failing_pool_ends_its_own_processes_alone(child):
    with pytest.raises(KeyboardInterrupt), process_pool(2, "died") as pool:
        with starting_processes():
            waiting = [pool.submit(time.sleep, 600.0) for _ in range(2)]
        own = set(multiprocessing.active_children()) - {child}
        raise KeyboardInterrupt
    assert len(waiting) == 2
    while any(process.exitcode is None for process in own):
        time.sleep(0.01)
    assert [process.exitcode for process in own] == [-signal.SIGKILL] * 2
    assert child.is_alive()


def test_process_that_dies_is_named(child):
    with pytest.raises(WorkerDied, match="it died"), process_pool(1, "it died") as pool:
        pool.submit(os._exit, 3).result()
    assert child.is_alive()
