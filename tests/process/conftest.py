"""What several files of process tests share."""

import pytest
from kit.deploy_bench import Bridge, driver

from rover_ncp import cli
from sim.park.live import LiveRun


@pytest.fixture(scope="module")
def keys(tmp_path_factory):
    folder = tmp_path_factory.mktemp("keys")
    assert cli.run(["keys", "--out", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """A mock and a bridge that drives it; a test leaves the rover standing, and no lease."""
    with LiveRun(tmp_path_factory.mktemp("rig")) as rig:
        yield rig


@pytest.fixture(scope="module")
def secured(keys, tmp_path_factory):
    """A mock and a bridge that listens with TLS and access control."""
    listen = ["--listen", "tls/127.0.0.1:0", "--zenoh-config", str(keys / "bridge.json5")]
    with LiveRun(tmp_path_factory.mktemp("rig"), bridge=listen) as rig:
        yield rig


@pytest.fixture
def bridge():
    """A fake bridge for a driver in this process."""
    bridge = Bridge()
    yield bridge
    bridge.close()


@pytest.fixture
def drive(bridge, tmp_path, capsys, monkeypatch):
    return driver(bridge, tmp_path, capsys, monkeypatch)
