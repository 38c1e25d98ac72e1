"""What holds for all runs of these tests."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def quick_runs():
    """Hide git, because a commit during the tests would change the records; draw no pictures of curves."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PATH", "")
        patch.setattr("sim.learn.train.curve_png", lambda *_: b"a picture")
        yield
