"""What several tests of commands that compute share."""

import pytest


@pytest.fixture
def no_git(monkeypatch):
    """Hide git: a commit during the tests would change the records."""
    monkeypatch.setenv("PATH", "")
