"""Builds the native library with the wheel, or beside its sources for an editable installation.

``python hatch_build.py [--sanitized FOLDER]`` builds it by itself. Without a compiler the wheel is pure:
circuits then run in Python, which is fast enough to drive, and training says what it needs.
"""

import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

NATIVE = Path(__file__).parent / "rover_ncp" / "native"
# Without fast-math and contraction every build gives the same bits.
FLAGS = [
    *("-std=c++17", "-O2", "-fPIC", "-ffp-contract=off", "-fno-exceptions", "-fno-rtti"),
    *("-fvisibility=hidden", "-Wall", "-Wextra", "-Werror"),
]
VARIANTS = {"": [], "-avx2": ["-mavx2"]}
"""Builds by suffix, with their flags: for all processors, and 20 % faster with AVX2."""
SANITIZERS = ["-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=undefined"]
ZIG = "ziglang==0.13.0"


def digest() -> str:
    """Return a digest of the sources, which the library holds and ``rover_ncp/native/core.py`` compares."""
    files = sorted([*NATIVE.glob("*.cpp"), *NATIVE.glob("*.h")])
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def compiler() -> list[str] | None:
    """Return the command of a C++ compiler that works: ``c++`` or ziglang's; None without one."""
    for command in (["c++"], [sys.executable, "-m", "ziglang", "c++"]):
        with tempfile.TemporaryDirectory() as folder:
            probe = Path(folder) / "probe.cpp"
            probe.write_text("int main() { return 0; }\n")
            compiling = [*command, "-c", str(probe), "-o", f"{folder}/probe.o"]
            try:
                if subprocess.run(compiling, capture_output=True, check=False).returncode == 0:
                    return command
            except OSError:
                continue
    return None


def build(folder: Path = NATIVE, extra: tuple[str, ...] = ()) -> list[Path]:
    """Compile the libraries into a folder and return them: none without a compiler."""
    command = compiler()
    if command is None:
        return []
    # C's linker, where there is one: the library needs nothing of C++.
    linker = ["cc"] if command == ["c++"] and shutil.which("cc") else command
    wide = not extra and platform.machine() in {"x86_64", "AMD64"}
    built = []
    for suffix, flags in VARIANTS.items() if wide else [("", [])]:
        library = folder / f"librover_ncp{suffix}.so"
        with tempfile.TemporaryDirectory(dir=folder) as work:
            objects = []
            for source in sorted(NATIVE.glob("*.cpp")):
                objects.append(f"{work}/{source.stem}.o")
                options = [*FLAGS, *flags, *extra, f'-DSOURCES="{digest()}"']
                subprocess.run([*command, *options, "-c", str(source), "-o", objects[-1]], check=True)
            linked = Path(work) / library.name
            subprocess.run([*linker, "-shared", *extra, *objects, "-o", str(linked), "-lm"], check=True)
            linked.replace(library)  # at once: another process may load it
        built.append(library)
    return built


if __name__ == "__main__":
    if sys.argv[1:2] == ["--sanitized"]:
        Path(sys.argv[2]).mkdir(parents=True, exist_ok=True)
        print(*build(Path(sys.argv[2]), tuple(SANITIZERS)), sep="\n")
    else:
        print(*build(), sep="\n")
else:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface

    class NativeBuild(BuildHookInterface):  # type: ignore[type-arg]
        """hatchling's hook."""

        def dependencies(self) -> list[str]:
            """Return what a build needs: a compiler from an index where the machine has none."""
            return [] if compiler() or os.environ.get("ROVER_NCP_PURE") else [ZIG]

        def initialize(self, version: str, build_data: dict[str, Any]) -> None:
            """Build the libraries, and tag the wheel for this platform if there are any."""
            import sysconfig

            if os.environ.get("ROVER_NCP_PURE") or not (libraries := build()):
                return
            platform_tag = sysconfig.get_platform().replace("-", "_").replace(".", "_")
            build_data["pure_python"] = False
            build_data["tag"] = f"py3-none-{platform_tag}"
            build_data["artifacts"] += [f"rover_ncp/native/{library.name}" for library in libraries]
