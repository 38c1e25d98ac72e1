"""What holds for all runs of these tests."""

import itertools

import pytest

from rover_ncp.core.files import write_atomic
from sim.learn import folder


@pytest.fixture(scope="module", autouse=True)
def quick_runs():
    """Hide git, because a commit during the tests would change the records; draw no pictures of curves."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PATH", "")
        patch.setattr("sim.learn.ensemble.curve_png", lambda *_: b"a picture")
        yield


@pytest.fixture
def dies(monkeypatch):
    """Return a function that calls another one, which a write of a run folder kills, as no handler notices.

    It returns whether the write of that number came.
    """

    class DiedError(BaseException):
        pass

    def dies(number, train):
        numbers = itertools.count()

        def dying_write(path, data):
            if next(numbers) == number:
                raise DiedError
            write_atomic(path, data)

        with monkeypatch.context() as patch:
            patch.setattr(folder, "write_atomic", dying_write)
            try:
                train()
            except DiedError:
                return True
        return False

    return dies
