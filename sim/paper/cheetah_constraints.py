"""Joint limits and the floor, as MuJoCo has them: soft constraints of the acceleration, with friction.

MuJoCo's documentation, chapters "Computation" and "Solver parameters": of all accelerations that is the right
one at which the squared distance to the free one, weighted by the inertia, and to what each violated
constraint asks for, weighted by its stiffness, is least. A constraint that would pull does not count.
"""

import numpy as np
from numpy.typing import NDArray

from rover_ncp.kernels.jit import inlined_kernel
from sim.paper.cheetah_model import COORDINATES, LEG, LINKS, TRUNK, Cheetah, CheetahWork, Softness

FloatArray = NDArray[np.float64]

_MOST_SETS = 20
"""Active sets that are tried; the second or third is right."""


@inlined_kernel
def find_constraints(cheetah: Cheetah, work: CheetahWork) -> int:
    """Write the rows of constraints that are violated, and return how many."""
    position, row, lowest, hinge, turn = work.position, work.row, work.lowest, work.hinge, work.turn
    rows = 0
    low, high, limit_weight = cheetah.low, cheetah.high, cheetah.limit_weight
    for link in range(1, LINKS):
        angle = position[link + 2]
        for side in (1.0, -1.0):
            distance = angle - low[link] if side > 0.0 else high[link] - angle
            if distance < 0.0:
                row[rows] = 0.0
                row[rows, link + 2] = side
                lowest[rows] = link + 2
                soften(work, rows, cheetah.at_limit, distance, limit_weight[link])
                rows += 1
    friction, parents, ends, end_link, radius = (
        cheetah.friction,
        cheetah.parent,
        cheetah.end,
        cheetah.end_link,
        cheetah.radius,
    )
    height = position[1] + cheetah.joint[0, 1]
    square = friction * friction
    for end in range(len(end_link)):
        link = end_link[end]
        x, z = rotated(turn, link, ends[end, 0], ends[end, 1])
        x, z = x + hinge[link, 0], z + hinge[link, 1]
        distance = height + z - radius[end]
        if distance >= 0.0:
            continue
        # The point of contact lies half way between the two surfaces.
        z -= radius[end] + 0.5 * distance
        for edge in range(3):
            row[rows + edge] = 0.0
            lowest[rows + edge] = link + 2
            slope = friction * (edge - 1)
            row[rows + edge, 0], row[rows + edge, 1] = slope, 1.0
            above = link
            while above >= 0:
                row[rows + edge, above + 2] = slope * (z - hinge[above, 1]) - (x - hinge[above, 0])
                above = parents[above]
            soften(
                work,
                rows + edge,
                cheetah.at_floor,
                distance,
                2.0 * square * cheetah.contact_weight[link] * (1.0 + square),
            )
        # Two edges of the pyramid of friction point across the plane, and do the same in it.
        work.weight[rows + 1] *= 2.0
        rows += 3
    return rows


@inlined_kernel
def rotated(turn: FloatArray, link: int, x: float, z: float) -> tuple[float, float]:
    """Return a vector of a link's frame in the world's axes."""
    sine, cosine = turn[link, 0], turn[link, 1]
    return cosine * x + sine * z, cosine * z - sine * x


@inlined_kernel
def soften(work: CheetahWork, at: int, softness: Softness, distance: float, mobility: float) -> None:
    """Set what acceleration a row asks for and how much it weighs, for a distance in m or rad."""
    part = min(-distance / softness.width, 1.0)
    grown = 2.0 * part * part if part < 0.5 else 1.0 - 2.0 * (1.0 - part) * (1.0 - part)
    impedance = softness.least + grown * (softness.most - softness.least)
    row, velocity = work.row, work.velocity
    speed = 0.0
    for i in range(COORDINATES):
        speed += row[at, i] * velocity[i]
    work.aim[at] = -softness.damping * speed - softness.stiffness * impedance * distance
    work.weight[at] = impedance / ((1.0 - impedance) * mobility)


@inlined_kernel
def satisfy(work: CheetahWork, rows: int) -> None:  # noqa: PLR0912  # parts of one loop
    """Find the acceleration at which each violated constraint either pushes or is left by itself."""
    acceleration, force, active, aim = work.acceleration, work.force, work.active, work.aim
    matrix, inertia, row, lowest, weight = work.matrix, work.inertia, work.row, work.lowest, work.weight
    for r in range(rows):
        active[r] = aim[r] > 0.0
    for _ in range(_MOST_SETS):
        for i in range(COORDINATES):
            acceleration[i] = force[i]
            for j in range(i + 1):
                matrix[i, j] = inertia[i, j]
        for r in range(rows):
            if active[r]:
                last = lowest[r]
                first = leg(last)
                for i in range(TRUNK):
                    part = weight[r] * row[r, i]
                    acceleration[i] += part * aim[r]
                    for j in range(i + 1):
                        matrix[i, j] += part * row[r, j]
                for i in range(first, last + 1):
                    part = weight[r] * row[r, i]
                    acceleration[i] += part * aim[r]
                    for j in range(TRUNK):
                        matrix[i, j] += part * row[r, j]
                    for j in range(first, i + 1):
                        matrix[i, j] += part * row[r, j]
        solve(matrix, acceleration)
        settled = True
        for r in range(rows):
            along = 0.0
            for i in range(TRUNK):
                along += row[r, i] * acceleration[i]
            for i in range(leg(lowest[r]), lowest[r] + 1):
                along += row[r, i] * acceleration[i]
            pushes = along < aim[r]
            settled = settled and pushes == active[r]
            active[r] = pushes
        if settled:
            return


@inlined_kernel
def leg(coordinate: int) -> int:
    """Return where the leg of a coordinate begins, for one of the trunk the next after it."""
    return TRUNK + (coordinate - TRUNK) // LEG * LEG if coordinate >= TRUNK else TRUNK


@inlined_kernel
def solve(matrix: FloatArray, right: FloatArray) -> None:
    """Solve for a right side (9,), in place; of the matrix, a lower triangle, D L of L' D L is left.

    No coordinate meets another leg's, and so does none of L.
    """
    for k in range(COORDINATES - 1, 0, -1):
        inverse = 1.0 / matrix[k, k]
        first = leg(k)
        for i in range(first, k):
            part = matrix[k, i] * inverse
            for j in range(TRUNK):
                matrix[i, j] -= part * matrix[k, j]
            for j in range(first, i + 1):
                matrix[i, j] -= part * matrix[k, j]
            right[i] -= part * right[k]
        for i in range(min(k, TRUNK)):
            part = matrix[k, i] * inverse
            for j in range(i + 1):
                matrix[i, j] -= part * matrix[k, j]
            right[i] -= part * right[k]
    for k in range(COORDINATES):
        total = right[k]
        for i in range(min(k, TRUNK)):
            total -= matrix[k, i] * right[i]
        for i in range(leg(k), k):
            total -= matrix[k, i] * right[i]
        right[k] = total / matrix[k, k]
