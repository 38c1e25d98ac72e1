"""A drive to a place as a process."""

from deploy.app import run
from deploy.place.place import load_place
from deploy.place.plan import place_course
from deploy.place.settings import place_config
from deploy.recorder import Recorder
from deploy.zenoh_client import BridgeAddress
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.console import Output
from rover_ncp.robot.description import RobotDescription
from rover_ncp.robot.profile import RoverProfile

DOCK_POLICY = "dock"


def run_to_place(
    name: str,
    process: tuple[BridgeAddress, Output, Recorder],
    *,
    staging: Policy,
    dock_policy: str | None,
    rover: RoverProfile | None,
    described: RobotDescription | None,
    undock: bool,
) -> int:
    """Drive to a place, or out of it, and return the exit code. Raises RoverNcpError as `deploy.app.run`."""
    address, output, recorder = process
    place, dock = load_place(name), load_policy(dock_policy or DOCK_POLICY)
    config = place_config(
        place,
        rover,
        described,
        undock=undock,
        robot=address.robot,
        namespace=address.namespace,
        policy=dock.circuit.name,
    )
    return run(
        address,
        output,
        policy=dock,
        course=place_course(place),
        config=config,
        recorder=recorder,
        staging=staging,
    )
