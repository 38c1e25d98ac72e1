"""The half-cheetah in its plane: MuJoCo's equations for this model, in a kernel, in a sixth of the time.

MuJoCo treats the half-cheetah as a body in space, which it is not: all hinges are parallel, and what is
left is a tree of nine coordinates whose two legs meet only in the torso. Formulas are those of MuJoCo's
documentation (chapters "Computation" and "Solver parameters"); every number comes from its compiled model.
The constrained acceleration minimises the same function (``cheetah_constraints.py``). A step differs from
MuJoCo's by rounding and by what its solver leaves undone.

Coordinates (9,): x, z, pitch, then the hinges of the back leg and of the front leg, downwards. Links (7,):
the torso, which turns by the pitch, then as the hinges. A positive angle turns x towards -z.
"""

import math

import numpy as np
from numpy.typing import NDArray

from rover_ncp.kernels.jit import inlined_kernel
from sim.paper.cheetah_constraints import find_constraints, rotated, satisfy, solve
from sim.paper.cheetah_model import COORDINATES, LINKS, Cheetah, CheetahWork

FloatArray = NDArray[np.float64]


@inlined_kernel
def step_cheetah(cheetah: Cheetah, work: CheetahWork, step_s: float, commands: FloatArray, lane: int) -> None:
    """Advance ``work.position`` and ``work.velocity`` (9,) by a step under commands (6, L), within ±1."""
    place_links(cheetah, work)
    sum_up(cheetah, work)
    move_freely(cheetah, work, commands, lane)
    rows = find_constraints(cheetah, work)
    satisfy(work, rows)
    # The dampers' forces are those at the end of the step: (M + h B) a' = M a.
    damping = cheetah.damping
    position, velocity, acceleration, change = (
        work.position,
        work.velocity,
        work.acceleration,
        work.change,
    )
    matrix, inertia = work.matrix, work.inertia
    for i in range(COORDINATES):
        for j in range(i + 1):
            matrix[i, j] = inertia[i, j]
    change[:2] = 0.0
    for link in range(LINKS):
        damped = step_s * damping[link]
        matrix[link + 2, link + 2] += damped
        change[link + 2] = damped * acceleration[link + 2]
    solve(matrix, change)
    for i in range(COORDINATES):
        velocity[i] += step_s * (acceleration[i] - change[i])
        position[i] += step_s * velocity[i]


@inlined_kernel
def place_links(cheetah: Cheetah, work: CheetahWork) -> None:
    """Find where links are, and how they would accelerate if no rate changed."""
    turn, rate, hinge, pull = work.turn, work.rate, work.hinge, work.pull
    position, velocity, parents, joint = work.position, work.velocity, cheetah.parent, cheetah.joint
    angles = work.angle
    for link in range(LINKS):
        angle, speed = position[link + 2], velocity[link + 2]
        parent = parents[link]
        if parent >= 0:
            angle += angles[parent]
            speed += rate[parent]
            x, z = rotated(turn, parent, joint[link, 0], joint[link, 1])
            square = rate[parent] * rate[parent]
            hinge[link, 0], hinge[link, 1] = hinge[parent, 0] + x, hinge[parent, 1] + z
            pull[link, 0], pull[link, 1] = pull[parent, 0] - square * x, pull[parent, 1] - square * z
        angles[link], rate[link] = angle, speed
        turn[link, 0], turn[link, 1] = math.sin(angle), math.cos(angle)


@inlined_kernel
def sum_up(cheetah: Cheetah, work: CheetahWork) -> None:
    """Sum up the masses of each link and all below, and the forces that would keep their rates."""
    turn, rate, hinge, pull, sums, below = (
        work.turn,
        work.rate,
        work.hinge,
        work.pull,
        work.sums,
        work.below,
    )
    masses, inertias, centers, parents = cheetah.mass, cheetah.inertia, cheetah.center, cheetah.parent
    for link in range(LINKS):
        x, z = rotated(turn, link, centers[link, 0], centers[link, 1])
        mass, square = masses[link], rate[link] * rate[link]
        force_x = mass * (pull[link, 0] - square * x)
        force_z = mass * (pull[link, 1] - square * z + cheetah.gravity)
        x, z = x + hinge[link, 0], z + hinge[link, 1]
        below[link] = mass
        sums[link, 0], sums[link, 1] = mass * x, mass * z
        sums[link, 2] = inertias[link] + mass * (x * x + z * z)
        sums[link, 3], sums[link, 4] = force_x, force_z
        sums[link, 5] = z * force_x - x * force_z
    for link in range(LINKS - 1, 0, -1):
        parent = parents[link]
        below[parent] += below[link]
        for i in range(6):
            sums[parent, i] += sums[link, i]


@inlined_kernel
def move_freely(cheetah: Cheetah, work: CheetahWork, commands: FloatArray, lane: int) -> None:
    """Find the inertia, and the forces of all but constraints."""
    inertia, force, hinge, sums, below = work.inertia, work.force, work.hinge, work.sums, work.below
    position, velocity, parents = work.position, work.velocity, cheetah.parent
    inertia[0, 0] = inertia[1, 1] = below[0]
    inertia[1, 0] = 0.0
    force[0], force[1] = -sums[0, 3], -sums[0, 4]
    for link in range(LINKS):
        x, z = hinge[link, 0], hinge[link, 1]
        i = link + 2
        inertia[i, 0] = sums[link, 1] - below[link] * z
        inertia[i, 1] = below[link] * x - sums[link, 0]
        above = link
        while above >= 0:
            over_x, over_z = hinge[above, 0], hinge[above, 1]
            inertia[i, above + 2] = (
                sums[link, 2]
                - sums[link, 0] * (x + over_x)
                - sums[link, 1] * (z + over_z)
                + below[link] * (x * over_x + z * over_z)
            )
            above = parents[above]
        inertia[i, i] += cheetah.armature[link]
        force[i] = (
            z * sums[link, 3]
            - x * sums[link, 4]
            - sums[link, 5]
            - cheetah.stiffness[link] * position[i]
            - cheetah.damping[link] * velocity[i]
        )
        if link > 0:
            force[i] += cheetah.gear[link] * commands[link - 1, lane]
