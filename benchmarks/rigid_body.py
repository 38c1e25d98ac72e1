"""The MuJoCo body against theory, and how far its results depend on the simulator's contacts.

    PYTHONPATH=tests python -m benchmarks.rigid_body

prints how a robot drives straight, brakes, turns on the spot and stands on a slope, beside what Coulomb
friction predicts; then the same turns under other contact settings.
"""

import math

from kit.rigid_body import (
    OMEGA_RAD_S,
    SETTINGS,
    V_M_S,
    Motion,
    coulomb,
    coulomb_downhill_m,
    creep_m_s,
    downhill_m,
    measure,
    shake_m_s2,
    stopping_m,
)

from sim.world.described import default_rover
from sim.world.skid_robot import SkidRobot

OFF_CENTRE_M = (0.0, 0.015, 0.03, 0.06)


def main() -> None:
    """Print the tables."""
    usual, model = SkidRobot(), default_rover()
    straight = measure(usual, V_M_S, 0.0)
    print(f"straight at {V_M_S} m/s: {straight.forward_m_s:.4f} m/s")
    print(
        f"stops after {1000 * stopping_m(usual, V_M_S):.1f} mm; v²/2a: {500 * V_M_S**2 / model.decel:.1f} mm"
    )
    for degrees in (1.0, 3.0):
        creep = creep_m_s(SkidRobot(slope_rad=math.radians(degrees)))
        print(f"stands on {degrees:g} degrees: {1000 * creep:.3f} mm/s downhill")
    slope = SkidRobot(slope_rad=math.radians(3.0))
    print(
        f"slides downhill as it turns on 3 degrees: {100 * downhill_m(slope):.2f} cm/rad; Coulomb friction: "
        f"{100 * coulomb_downhill_m(slope):.2f}"
    )
    print(f"\nturn on the spot at {OMEGA_RAD_S} rad/s, as turn gain and slide in cm")
    print(f"{'':26}" + "".join(f"{f'{100 * off:g} cm ahead':>18}" for off in OFF_CENTRE_M))
    robots = [SkidRobot(mass_center_m=(off, 0.0)) for off in OFF_CENTRE_M]
    _row("Coulomb friction", [coulomb(robot, 0.0, OMEGA_RAD_S) for robot in robots])
    for name, contact in SETTINGS.items():
        for friction in (0.4, 1.0):
            changes = {"friction": friction, "contact": contact}
            changed = [robot.model_copy(update=changes) for robot in robots]
            _row(f"{name}, μ={friction:g}", [measure(robot, 0.0, OMEGA_RAD_S) for robot in changed])
            shake = max(shake_m_s2(robot, OMEGA_RAD_S) for robot in changed)
            print(f"{'':26}vertical acceleration ±{shake:.3f} m/s²")


def _row(name: str, motions: list[Motion]) -> None:
    cells = (f"{motion.turn_gain:.3f}, {100 * motion.slide_m:5.1f}" for motion in motions)
    print(f"{name:26}" + "".join(f"{cell:>18}" for cell in cells))


if __name__ == "__main__":
    main()
