"""What proves a docking, and what does not: reports of a charge and topics of the robot."""

from kit.virtual_docking import VirtualDocking, charging, place
from kit.virtual_drive import ChangedLink

from deploy.place.outcome import DockError, Stage
from deploy.view.recorded_drive import read_drive, summarise
from rover_ncp.core.geometry import Pose
from rover_ncp.wire.messages import (
    battery_state,
    read_battery,
)


class Racing(ChangedLink):
    """Receives that the charge ended at once after the control loop, which waits, has read that it flows."""

    received = False

    def __getattribute__(self, name):
        value = super().__getattribute__(name)
        waits = isinstance(value, tuple) and value[:1] == (True,) and not Racing.received
        if waits and self.statuses and self.statuses[-1].state.startswith(Stage.WAIT_FOR_CHARGE):
            Racing.received = True
            stamp_ns = self.bridge.time_ns()
            self.put("battery_state", battery_state(12.5, stamp_ns, charging=False))
        return value


def test_report_that_comes_while_the_last_one_is_read_makes_no_charge_of_it():
    drive = VirtualDocking(place(proof="charging", retries=0), Pose(1.955, 1.0, 0.0))
    drive.link.__class__ = Racing
    stamps = []

    def repeated(data):
        stamps.append(read_battery(data).stamp_ns)
        return None if Racing.received else battery_state(12.5, stamps[0], charging=True)

    drive.link.change["battery_state"] = repeated
    dock = drive.run().dock
    assert Racing.received
    assert (dock.success, dock.error_code) == (False, DockError.FAILED_TO_CHARGE)


def test_page_of_a_docking_whose_driver_was_killed_claims_nothing(tmp_path):
    drive = charging(VirtualDocking(place(proof="charging", retries=0), Pose(2.0, 1.0, 0.0)), None)
    drive.run()
    states = {message.log_ns for message in drive.recorded if b"RETRY" in message.data}
    drive.recorded = [message for message in drive.recorded if message.log_ns < min(states)]
    drive.path = tmp_path / "killed.mcap"
    drive._write()
    summary = summarise(read_drive(drive.path))
    assert summary.parked == "not parked"
    assert summary.headline == "Not docked at bay: the recording ends before the driver's verdict"
    assert "By the estimated pose" not in dict(summary.rows)
