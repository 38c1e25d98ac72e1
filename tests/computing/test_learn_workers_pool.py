"""A pool of processes in a program that has children of its own."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time

import pytest
from kit.training_processes import is_running

from sim.learn.workers import ProcessPool, WorkerDied
from sim.park.live import wait_for


@pytest.fixture(scope="module")
def child():
    """A child of the host program."""
    process = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(600.0,))
    process.start()
    yield process
    process.kill()
    process.join()


def test_failing_pool_ends_its_own_processes_alone(child):
    with pytest.raises(KeyboardInterrupt), ProcessPool(2) as pool:
        waiting = [pool.submit(time.sleep, 600.0) for _ in range(2)]
        own = set(multiprocessing.active_children()) - {child}
        raise KeyboardInterrupt
    assert len(waiting) == 2
    while any(process.exitcode is None for process in own):
        time.sleep(0.01)
    assert [process.exitcode for process in own] == [-signal.SIGKILL] * 2
    assert child.is_alive()


def test_process_that_dies_is_reported(child):
    with pytest.raises(WorkerDied, match="a worker process was killed"), ProcessPool(1) as pool:
        pool.submit(signal.raise_signal, signal.SIGKILL).result()
    assert child.is_alive()
    assert multiprocessing.active_children() == [child]


def test_processes_end_with_their_parent():
    script = (
        "import os, time\nfrom sim.learn.workers import ProcessPool\n"
        "if __name__ == '__main__':\n"
        "    with ProcessPool(1) as pool:\n"
        "        print(pool.submit(os.getpid).result(), flush=True)\n        time.sleep(600)\n"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as parent:
        worker = int(parent.stdout.readline())
        os.kill(worker, 0)
        parent.kill()

    wait_for(lambda: not is_running(worker), 10.0)
