"""The simulators of a rover, and the shipped randomizations of each. Light: command lines read it."""

from enum import StrEnum


class Body(StrEnum):
    """What simulates the rover's motion."""

    PYMUNK = "pymunk"
    """Rigid body in the plane with set accelerations: the simulator of the training."""
    MUJOCO = "mujoco"
    """Four wheels with friction, weight and motors: an independent simulator, to judge."""


PRESETS = {
    Body.PYMUNK: ("none", "mild", "full", "harsh", "skid", "far", "docking"),
    Body.MUJOCO: ("nominal", "varied", "slope", "rough", "lasting"),
}
"""The first changes nothing."""

BODY_WORDS = "Simulator of the rover: pymunk, or mujoco, which needs the extra research."
PRESET_WORDS = "; ".join(f"{body}: {', '.join(names)}" for body, names in PRESETS.items())
"""For the help of an option, as BODY_WORDS."""
