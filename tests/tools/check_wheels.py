"""Check the wheels in dist: ``make dist``.

The library of a Linux wheel needs a C library that is no newer than its tag says, and gives this machine's
bits: under emulation, or installed into an environment of its own. Wheels for macOS are not run.
"""

import platform
import re
import shutil
import subprocess
import sys
import tempfile
import venv
import zipfile
from pathlib import Path

import numpy as np

from rover_ncp.circuit.compiled import make_circuits
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.native.core import Axes, bound_tick, structures

ROOT = Path(__file__).parents[2]
EMULATED = {"aarch64": ("aarch64-linux-gnu", "arm64"), "armv7l": ("arm-linux-gnueabihf", "armhf")}
"""Processors by the end of a tag: what zig and Debian call them."""
TICKS = 50
TICK = """
import numpy as np
from rover_ncp import Runner, load_policy
from rover_ncp.circuit import runner

observations = np.random.default_rng(0).uniform(-1, 1, (50, 5))
policy = load_policy("course")
ticks = [[*map(Runner(policy).tick, observations)]]
assert runner.library()
runner.library = runner._warn_once = lambda: None
ticks.append([*map(Runner(policy).tick, observations)])
assert ticks[0] == ticks[1]
"""


def check_needs(wheel):
    """Return the C library that a wheel needs. Raises ValueError if its tag promises an older one."""
    shown = subprocess.run(
        [sys.executable, "-m", "auditwheel", "show", str(wheel)], capture_output=True, text=True, check=True
    ).stdout
    needed, promised = (
        tuple(map(int, re.search(pattern, text).groups()))
        for pattern, text in ((r'tag:\s+"manylinux_(\d+)_(\d+)_', shown), (r"linux_(\d+)_(\d+)_", wheel.name))
    )
    if needed > promised or "libstdc++" in shown:
        raise ValueError(f"{wheel.name} needs more than its tag says:\n{shown}")
    return f"needs glibc {needed[0]}.{needed[1]}"


def image(circuits, observations, commands):
    """Return the words of a call of the library, for ``tick.c``."""
    found = structures(
        circuits=circuits,
        observations=(observations[0], np.float64, Axes("inputs", "lanes")),
        commands=(commands, np.float64, Axes("outputs|motor_channels", "lanes")),
    )
    words = [len(observations), *[0] * len(found)]
    addresses = []
    for at, structure in enumerate(found, 1):
        words[at] = len(words)
        words += structure.words.view(np.int64).tolist()
    for array in [*arrays(circuits), observations, commands]:
        places = [i for i, word in enumerate(words) if word == array.ctypes.data]
        for place in places:
            words[place] = len(words)
        addresses += places
        words += array.view(np.int64).ravel().tolist()
    return np.array([len(addresses), *addresses, *words], np.int64)


def arrays(value):
    """Yield the arrays of a named tuple."""
    for part in value:
        if isinstance(part, np.ndarray):
            yield part
        elif isinstance(part, tuple):
            yield from arrays(part)


def check_emulated(wheel, zig_name, debian_name):
    """Compare ticks of a wheel's library under emulation with those of this machine's library."""
    emulator = f"qemu-{zig_name.split('-', maxsplit=1)[0]}"
    if not shutil.which(emulator):
        return f"not run: apt-get install qemu-user libc6-{debian_name}-cross"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        library = zipfile.ZipFile(wheel).extract("rover_ncp/native/librover_ncp.so", folder)
        compiling = [sys.executable, "-m", "ziglang", "cc", "-target", f"{zig_name}.2.28"]
        subprocess.run([*compiling, Path(__file__).with_name("tick.c"), "-o", folder / "tick"], check=True)
        for policy, lanes in [(load_policy("parking"), 1), (load_policy("course"), 11)]:
            shape = TICKS, len(policy.sensing.inputs), lanes
            observations = np.random.default_rng(0).uniform(-1, 1, shape)
            commands = np.zeros((len(policy.motors.outputs), lanes))
            circuits = make_circuits(policy, lanes)
            image(circuits, observations, commands).tofile(folder / "image")
            running = [emulator, "-L", f"/usr/{zig_name}", folder / "tick", library, folder / "image"]
            given = subprocess.run(running, stdout=subprocess.PIPE, check=True).stdout
            expected = b""
            seen = np.empty(shape[1:])
            tick = bound_tick(circuits, seen, commands)
            for seen[:] in observations:
                tick()
                expected += commands.tobytes()
            if given != expected:
                raise ValueError(f"{wheel.name}: other bits under emulation than here")
    return f"{2 * TICKS} ticks under {emulator} as here, bit by bit"


def check_installed(folder):
    """Install the wheel that pip chooses for this machine, and compare its ticks with the reference's."""
    with tempfile.TemporaryDirectory() as name:
        venv.create(name, with_pip=True)
        python = f"{name}/bin/python"
        pip = [python, "-m", "pip", "install", "--quiet", "--constraint", ROOT / "constraints.txt"]
        subprocess.run([*pip, "--no-index", "--no-deps", "-f", folder, "rover-ncp"], check=True)
        subprocess.run([*pip, "rover-ncp"], check=True)
        subprocess.run([python, "-I", "-W", "ignore", "-c", TICK], check=True, cwd=name)
    return f"{TICKS} ticks in an environment of its own as the reference, bit by bit"


def check(wheel):
    """Yield what is found of a wheel."""
    tag = wheel.stem.rsplit("-", 1)[-1]
    if "linux" not in tag:
        yield "not run"
        return
    yield check_needs(wheel)
    if tag.endswith(platform.machine()):
        yield check_installed(wheel.parent)
    for machine, names in EMULATED.items():
        if tag.endswith(machine):
            yield check_emulated(wheel, *names)


if __name__ == "__main__":
    for path in sorted((ROOT / "dist").glob("*.whl")):
        print(path.name, *check(path), sep="\n    ")
