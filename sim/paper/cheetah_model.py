"""The numbers of the half-cheetah, as MuJoCo compiles them, and room to work with them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

COORDINATES = 9
LINKS = 7
TRUNK, LEG = 3, 3
"""Coordinates of the trunk, then of each leg."""
_MOST_ROWS = 54
"""Three of each of 16 ends of capsules, and a hinge is at one of its limits at most."""
_LEAST_IMPEDANCE = 1e-4
"""MuJoCo raises smaller values to this."""


class Softness(NamedTuple):
    """A constraint's parameters: solref and solimp, with this model's power of 2 and midpoint of 0.5."""

    stiffness: float
    damping: float
    least: float
    most: float
    width: float


class Cheetah(NamedTuple):
    """The numbers of the model."""

    gravity: float
    parent: IntArray
    joint: FloatArray
    center: FloatArray
    """(7, 2) each: a link's hinge in its parent's frame or the world's, and its centre in its own."""
    mass: FloatArray
    inertia: FloatArray
    """(7,) kg and kg m²."""
    stiffness: FloatArray
    damping: FloatArray
    armature: FloatArray
    low: FloatArray
    high: FloatArray
    gear: FloatArray
    limit_weight: FloatArray
    """(7,) of the hinges, of the pitch first."""
    end_link: IntArray
    end: FloatArray
    radius: FloatArray
    """(E,) and (E, 2) of the spheres that capsules end in: their link, their place in its frame; (E,)."""
    friction: float
    contact_weight: FloatArray
    """(7,) inverse of the mass that MuJoCo reckons a link's contact to move."""
    at_limit: Softness
    at_floor: Softness


class CheetahWork(NamedTuple):
    """Work arrays of a step; only positions and velocities are its input and its result."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    """(9,) each."""
    force: FloatArray
    change: FloatArray
    """(9,) of all but constraints; of the acceleration, by dampers."""
    angle: FloatArray
    rate: FloatArray
    """(7,) each, of a link, rad and rad/s."""
    turn: FloatArray
    """(7, 2) its sine and cosine."""
    hinge: FloatArray
    pull: FloatArray
    """(7, 2) each, from the torso's hinge: a link's hinge, and its acceleration while no rate changes."""
    sums: FloatArray
    """(7, 6) of a link and all below: moments x z, inertia, force x z, torque, about the torso's hinge."""
    below: FloatArray
    """(7,) kg of a link and all below."""
    inertia: FloatArray
    matrix: FloatArray
    """(9, 9) each, the lower triangle."""
    row: FloatArray
    """(R, 9) Jacobians of constraints."""
    lowest: IntArray
    aim: FloatArray
    weight: FloatArray
    active: NDArray[np.bool_]
    """(R,) each: the last coordinate that a constraint involves, the acceleration it asks for, how much that
    weighs, whether it pushes."""


_NONE, _NO_PLACES = np.zeros(0), np.zeros((0, 2))
_NO_LINKS, _HARD = np.zeros(0, np.int64), Softness(0.0, 0.0, 0.0, 0.0, 0.0)
NO_CHEETAH = Cheetah(
    gravity=0.0,
    parent=_NO_LINKS,
    joint=_NO_PLACES,
    center=_NO_PLACES,
    mass=_NONE,
    inertia=_NONE,
    stiffness=_NONE,
    damping=_NONE,
    armature=_NONE,
    low=_NONE,
    high=_NONE,
    gear=_NONE,
    limit_weight=_NONE,
    end_link=_NO_LINKS,
    end=_NO_PLACES,
    radius=_NONE,
    friction=0.0,
    contact_weight=_NONE,
    at_limit=_HARD,
    at_floor=_HARD,
)
"""Placeholder for plants without a half-cheetah."""


def cheetah_work() -> CheetahWork:
    """Return room to work in."""
    n, links, rows = COORDINATES, LINKS, _MOST_ROWS
    return CheetahWork(
        position=np.zeros(n),
        velocity=np.zeros(n),
        acceleration=np.zeros(n),
        force=np.zeros(n),
        change=np.zeros(n),
        angle=np.zeros(links),
        rate=np.zeros(links),
        turn=np.zeros((links, 2)),
        hinge=np.zeros((links, 2)),
        pull=np.zeros((links, 2)),
        sums=np.zeros((links, 6)),
        below=np.zeros(links),
        inertia=np.zeros((n, n)),
        matrix=np.zeros((n, n)),
        row=np.zeros((rows, n)),
        lowest=np.zeros(rows, np.int64),
        aim=np.zeros(rows),
        weight=np.zeros(rows),
        active=np.zeros(rows, np.bool_),
    )


def load_cheetah(file: str) -> Cheetah:
    """Read one of Gymnasium's files, as MuJoCo compiles it."""
    import mujoco  # an extra that kernels do without

    from sim.paper.mujoco_plants import model_file

    model = mujoco.MjModel.from_xml_path(str(model_file(file)))
    links = slice(1, 1 + LINKS)
    plane = [0, 2]
    turned = np.zeros((model.nbody, 9))
    for row, quaternion in zip(turned, model.body_iquat, strict=True):
        mujoco.mju_quat2Mat(row, quaternion)
    across = turned.reshape(-1, 3, 3)[:, 1]
    capsules = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE)
    [floor] = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    ends = []
    for geom in capsules:
        axis = np.zeros(3)
        mujoco.mju_rotVecQuat(axis, np.array([0.0, 0.0, model.geom_size[geom, 1]]), model.geom_quat[geom])
        ends += [(model.geom_pos[geom] + side * axis)[plane] for side in (1.0, -1.0)]
    joint = model.body_pos[links][:, plane].copy()
    gear = np.zeros(LINKS)
    gear[model.actuator_trnid[:, 0] - 2] = model.actuator_gear[:, 0]
    friction = float(max(model.geom_friction[floor, 0], model.geom_friction[capsules[0], 0]))
    hinges = slice(2, COORDINATES)
    return Cheetah(
        gravity=-model.opt.gravity[2],
        parent=model.body_parentid[links].astype(np.int64) - 1,
        joint=joint,
        center=model.body_ipos[links][:, plane].copy(),
        mass=model.body_mass[links].copy(),
        inertia=(across**2 * model.body_inertia).sum(axis=1)[links],
        stiffness=model.jnt_stiffness[hinges].copy(),
        damping=model.dof_damping[hinges].copy(),
        armature=model.dof_armature[hinges].copy(),
        low=np.where(model.jnt_limited[hinges], model.jnt_range[hinges, 0], -np.inf),
        high=np.where(model.jnt_limited[hinges], model.jnt_range[hinges, 1], np.inf),
        gear=gear,
        limit_weight=model.dof_invweight0[hinges].copy(),
        end_link=np.repeat(model.geom_bodyid[capsules].astype(np.int64) - 1, 2),
        end=np.array(ends),
        radius=np.repeat(model.geom_size[capsules, 0], 2),
        friction=friction,
        contact_weight=model.body_invweight0[links, 0].copy(),
        at_limit=_softness(model.jnt_solref[-1], model.jnt_solimp[-1]),
        at_floor=_softness(model.geom_solref[floor], model.geom_solimp[floor]),
    )


def _softness(solref: FloatArray, solimp: FloatArray) -> Softness:
    most = float(solimp[1])
    return Softness(
        stiffness=1.0 / (most * solref[0] * solref[1]) ** 2,
        damping=2.0 / (most * solref[0]),
        least=max(float(solimp[0]), _LEAST_IMPEDANCE),
        most=most,
        width=float(solimp[2]),
    )
