"""The demo: one page on which a circuit parks a rover, in the browser alone.

The page holds the native library's circuit as WebAssembly, and a policy as the library reads it in memory.
Structures have their layout there: an address takes the lower half of its 8 bytes.

    python docs/demo/build.py build/demo.html
"""

import base64
import struct
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import ChoiceLoader, Environment, FileSystemLoader, PackageLoader
from markupsafe import Markup

from deploy.view.page_data import circuit_data, course_data
from rover_ncp.circuit.circuit import BOUNDS, RESTING_MV, ParameterKind
from rover_ncp.circuit.compiled import make_circuits
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.course.builder import CoursePose, PoseList, make_course
from rover_ncp.course.course import Course, load_course
from rover_ncp.course.hold import HOLD, hold_from_s
from rover_ncp.course.reference import plan_reference
from rover_ncp.course.signals import SIGNALS
from sim.world.described import default_rover

FOLDER = Path(__file__).parent
CIRCUIT = FOLDER.parents[1] / "rover_ncp" / "native" / "circuit.cpp"
# The flags of hatch_build.py that decide the bits. A page of 64 KiB holds the stack.
COMPILE = [
    *(sys.executable, "-m", "ziglang", "c++", "-target", "wasm32-freestanding", "-std=c++17", "-Os"),
    *("-ffp-contract=off", "-fno-exceptions", "-fno-rtti", '-DSOURCES="demo"', "-nostdlib", "-s"),
    *("-Wl,--no-entry", "-Wl,-z,stack-size=65536", "-Wl,--export=__heap_base"),
    *("-Wl,--export=rover_ncp_tick_lanes", "-Wl,--export=rover_ncp_fill_lanes"),
]
ADDRESS = 1 << 17
"""Of the policy in the module's memory, behind the stack and the module's own data."""
TURN = ((0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.9, 0.6, 1.5708), (0.9, 1.0, 1.5708))
COURSES = {
    "longer": "Two bends, 2.5 m",
    "bay": "Into a bay between two cars",
    "parking": "The paper's manoeuvre",
    "mirrored": "The same to the right",
    "turn": "A quarter turn to the left",
}
"""Titles of the courses by name; ``turn`` is made of poses, the others are shipped."""


@cache
def compile_circuit() -> bytes:
    """Return the WebAssembly module. Raises CalledProcessError without the package ziglang."""
    with tempfile.TemporaryDirectory() as folder:
        module = Path(folder) / "circuit.wasm"
        subprocess.run([*COMPILE, str(CIRCUIT), "-o", str(module)], check=True)
        return module.read_bytes()


class Image:
    """Arrays and structures at their addresses in the module's memory."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.addresses: dict[str, int] = {}
        """Of each array, by its path."""

    def put(self, path: str, data: bytes) -> int:
        """Append data that is a multiple of 8 bytes long and return its address."""
        self.addresses[path] = ADDRESS + len(self.data)
        self.data += data
        return self.addresses[path]

    def words(self, path: str, value: Any) -> bytes:
        """Return a value as the library reads it, and put its arrays into memory."""
        if isinstance(value, np.ndarray):
            address = self.put(path, np.ascontiguousarray(value).tobytes())
            return struct.pack(f"<{1 + value.ndim}q", address, *value.shape)
        if isinstance(value, tuple):
            parts = zip(value._fields, value, strict=True)  # type: ignore[attr-defined]
            return b"".join(self.words(f"{path}.{name}", part) for name, part in parts)
        return struct.pack("<d" if isinstance(value, float) else "<q", value)


def core_data(policy: Policy) -> dict[str, Any]:
    """Return the module, and the memory with one circuit at rest in it."""
    image, layout = Image(), policy.layout()
    arguments = {
        "circuits": make_circuits(policy, 1),
        "observations": np.zeros((len(policy.sensing.inputs), 1)),
        "commands": np.zeros((len(policy.motors.outputs), 1)),
        "vectors": policy.parameters()[None, :],
    }
    structures = {name: image.put("", image.words(name, value)) for name, value in arguments.items()}
    return {
        "module": base64.b64encode(compile_circuit()).decode(),
        "memory": base64.b64encode(image.data).decode(),
        "address": ADDRESS,
        "structures": structures,
        "arrays": {name: image.addresses[name] for name in ("circuits.potentials", *[*arguments][1:])},
        "blocks": {block.kind: block.slice.start for block in layout.blocks},
        "parameters": policy.parameters().tolist(),
        "inputs": [SIGNALS.index(name) for name in policy.sensing.inputs],
        "outputs": len(policy.motors.outputs),
        "resting": RESTING_MV,
        "silent": BOUNDS[ParameterKind.LEAK_POTENTIAL].lower,
    }


def drive_data(course: Course) -> dict[str, Any]:
    """Return a course with its reference at each tick: x, y, theta, v, omega."""
    reference = plan_reference(course)
    ticks = np.array([[*pose, *motion] for pose, motion in map(reference.tick, range(course.ticks + 1))])
    return course_data(course) | {
        "name": course.name,
        "title": COURSES[course.name],
        "ticks": ticks.round(6).tolist(),
        "start": course.start_signal_s,
        "target": list(course.goal),
        "hold": hold_from_s(course),
        "parked": course.parked.model_dump(),
    }


def demo_page(policy_name: str = "course") -> str:
    """Return the page as HTML."""
    policy = load_policy(policy_name)
    poses = PoseList(poses=tuple(CoursePose(x=x, y=y, theta=theta) for x, y, theta in TURN))
    turn, _ = make_course("turn", "poses", poses)
    courses = [turn if name == "turn" else load_course(name) for name in COURSES]
    loader = ChoiceLoader([FileSystemLoader(FOLDER), PackageLoader("deploy.view", "assets")])
    pages = Environment(loader=loader, autoescape=True, trim_blocks=True)
    pages.globals["asset"] = lambda name: Markup(loader.get_source(pages, name)[0])
    data = {
        "core": core_data(policy),
        "circuit": circuit_data(policy),
        "courses": [drive_data(course) for course in courses],
        "rover": default_rover().model_dump() | {"hold_v": HOLD.v, "hold_omega": HOLD.omega},
    }
    return pages.get_template("demo.html").render(data=data, policy=policy)


if __name__ == "__main__":
    Path(sys.argv[1]).parent.mkdir(parents=True, exist_ok=True)
    Path(sys.argv[1]).write_text(demo_page())
