"""A policy of a user in Python behind the driver: its drive, its faults, and what it does not go with."""

import pytest
from kit.virtual_drive import VirtualDrive

import deploy.app
from rover_ncp.cli import run

MODULE = """
class Ahead:
    signals = ("longitudinal", "speed")
    ticks = 0

    def __call__(self, observation):
        assert observation.shape == (2,)
        self.ticks += 1
        return (0.1, 0.0) if self.ticks < 20 else (0.0, 0.0)

class Fails(Ahead):
    def __call__(self, observation):
        v, omega = super().__call__(observation)
        return v / (self.ticks < 15), omega
"""


@pytest.fixture
def virtual(tmp_path, monkeypatch):
    """Have the command drive the rover of a virtual bridge."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "driven_module.py").write_text(MODULE)
    virtual = VirtualDrive()
    virtual.use_in(deploy.app, monkeypatch)
    return virtual


def drive(name, *more):
    return run(["deploy", "--robot", "virtual", "--policy", f"driven_module:{name}", *more])


def test_policy_of_ones_own_drives_the_rover_and_is_judged(virtual, capsys):
    assert drive("Ahead", "--duration", "4") == 1
    assert "not parked" in capsys.readouterr().out
    assert 0.1 < virtual.rover.pose.x < 0.25
    assert virtual.stands()
    assert virtual.link.gate.lease == 0


def test_exception_of_the_policy_stops_the_rover_and_is_named(virtual, capsys):
    assert drive("Fails") == 2
    assert "ZeroDivisionError" in capsys.readouterr().err
    assert virtual.rover.pose.x > 0.0
    assert virtual.stands()
    assert virtual.link.gate.lease == 0


@pytest.mark.parametrize("more", [("--record", "run.mcap"), ("--to", "place.yaml")])
def test_what_needs_a_circuit_is_refused(virtual, more, capsys):
    assert drive("Ahead", *more) == 2
    assert f"{more[0]}: does not go with --policy" in capsys.readouterr().err
