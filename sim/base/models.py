"""The Pioneers that the mock can be: rover, FLASH values, names.

Factors, outlines and motion are those of the descriptions; FLASH values from real and simulated CONFIGpacs
(AriaCoda issue 15, AMRISim). Values without a source are chosen, and are marked so.
"""

import math

from bridge.pioneer.packets import ConfigPac
from rover_ncp.robot.description import RobotDescription
from sim.world.described import described_rover

BASE_NAME, BASE_CLASS = "rover-ncp_mock", "Pioneer"

TICKS_PER_MM = 128
"""TicksMM as users of P3-DX and P3-AT set it (rosaria issues 31 and 68)."""

BUMPER_SEGMENTS = 5
"""Front and rear, as ARIA's defaults."""


def config_of(robot: RobotDescription) -> ConfigPac:
    """Return the CONFIGpac of a model fresh from power-up. Its COUNT is beyond 127, as a real one's."""
    assert robot.arcos is not None
    rover = described_rover(robot)
    accel, decel = round(rover.accel * 1000), round(rover.decel * 1000)
    turn_accel, turn_decel = round(math.degrees(rover.alpha)), round(math.degrees(rover.alpha_decel))
    return ConfigPac(
        robot_type=BASE_CLASS,
        subtype=robot.name,
        serial_number="MOCK",
        rot_vel_top=robot.arcos.omega_top_deg_s,
        trans_vel_top=robot.arcos.v_top_mm_s,
        rot_acc_top=300,
        trans_acc_top=2000,
        pwm_max=500,
        name=BASE_NAME,
        sip_cycle=100,
        front_sonar=1,
        rear_sonar=1,
        low_battery=115,
        rev_count=16500,
        watchdog=2000,
        stall_val=200,
        stall_count=200,
        rot_vel_max=round(math.degrees(rover.omega_max)),
        trans_vel_max=round(rover.v_max * 1000),
        rot_acc=turn_accel,
        rot_decel=turn_decel,
        trans_acc=accel,
        trans_decel=decel,
        front_bumps=BUMPER_SEGMENTS,
        rear_bumps=BUMPER_SEGMENTS,
        sonar_cycle=40,
        autobaud=2,
        ticks_mm=TICKS_PER_MM,
        shutdown_volts=100,
        version="2.9",
    )
