"""Builds the native library with the wheel, or beside its sources for an editable installation.

``python hatch_build.py [--sanitized FOLDER]`` builds it by itself. Without a compiler the wheel is pure:
circuits then run in Python, which is fast enough to drive, and training says what it needs. The environment
variable ``ROVER_NCP_PURE`` demands such a wheel, ``ROVER_NCP_TARGET`` a wheel for one of ``TARGETS``.

``ROVER_NCP_SOURCE`` and ``ROVER_NCP_SITE`` are the addresses of the repository and of the pages. A release
sets them: links and the picture of README.md then lead there, because an index has no such files.
"""

import hashlib
import os
import platform
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

NATIVE = Path(__file__).parent / "rover_ncp" / "native"
# Without fast-math and contraction every build gives the same bits.
FLAGS = [
    *("-std=c++17", "-O2", "-fPIC", "-ffp-contract=off", "-fno-exceptions", "-fno-rtti"),
    *("-fvisibility=hidden", "-Wall", "-Wextra"),
]
VARIANTS = {"": [], "-avx2": ["-mavx2"]}
"""Builds by suffix, with their flags: for all processors, and 20 % faster with AVX2."""
SANITIZERS = [
    *("-g", "-O1", "-Werror", "-fsanitize=address,undefined", "-fno-sanitize-recover=undefined"),
]
TARGETS = {
    "manylinux_2_17_x86_64": "x86_64-linux-gnu.2.17",
    "manylinux_2_28_aarch64": "aarch64-linux-gnu.2.28",
    "manylinux_2_28_armv7l": "arm-linux-gnueabihf.2.28",
    "macosx_11_0_arm64": "aarch64-macos.11.0",
    "macosx_11_0_x86_64": "x86_64-macos.11.0",
}
"""Platform tags of the wheels of a release, and what zig calls these platforms."""
ZIG = [sys.executable, "-m", "ziglang", "c++"]
ZIG_PACKAGE = 'ziglang==0.13.0; platform_machine in "x86_64 aarch64 armv7l arm64"'
PAPER = "https://doi.org/10.48550/arXiv.1809.04423"
PROBE = "#include <math.h>\n#include <stdint.h>\nint64_t probe(double x) { return (int64_t)hypot(x, 1); }\n"


def digest() -> str:
    """Return a digest of the sources, which the library holds and ``rover_ncp/native/core.py`` compares."""
    files = sorted([*NATIVE.glob("*.cpp"), *NATIVE.glob("*.h")])
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def compiler() -> list[str] | None:
    """Return the command of a C++ compiler that works: ``c++`` or ziglang's; None without one."""
    for command in (["c++"], ZIG):
        with tempfile.TemporaryDirectory() as folder:
            probe = Path(folder) / "probe.cpp"
            probe.write_text(PROBE)
            try:
                link(command, [probe], Path(folder) / "probe.so", FLAGS, quiet=True)
            except (OSError, subprocess.CalledProcessError):
                continue
            return command
    return None


def link(
    command: list[str], sources: list[Path], library: Path, flags: list[str], quiet: bool = False
) -> None:
    """Compile sources and link them. Raises OSError or CalledProcessError."""
    # C's linker: the library needs nothing of C++. It leaves out names, except for sanitizers.
    linker = ["cc" if word == "c++" else word for word in command]
    kept = SANITIZERS if "-g" in flags else ["-s"]
    with tempfile.TemporaryDirectory(dir=library.parent) as work:
        objects = [f"{work}/{source.stem}.o" for source in sources]
        linked = Path(work) / library.name
        for line in (
            *([*command, *flags, "-c", str(s), "-o", o] for s, o in zip(sources, objects, strict=True)),
            [*linker, *kept, "-shared", *objects, "-o", str(linked), "-lm"],
        ):
            subprocess.run(line, check=True, capture_output=quiet)
        linked.replace(library)  # at once: another process may load it


def build(folder: Path = NATIVE, target: str | None = None, extra: list[str] | None = None) -> list[Path]:
    """Compile the libraries into a folder and return them: none without a compiler."""
    command = [*ZIG, "-target", TARGETS[target]] if target else compiler()
    if command is None:
        return []
    wide = not extra and (target or platform.machine()).endswith(("x86_64", "AMD64"))
    built = []
    for suffix, flags in VARIANTS.items() if wide else [("", [])]:
        built.append(folder / f"librover_ncp{suffix}.so")
        options = [*FLAGS, *flags, *(extra or []), f'-DSOURCES="{digest()}"']
        link(command, sorted(NATIVE.glob("*.cpp")), built[-1], options)
    return built


def with_addresses(text: str, source: str, tag: str) -> str:
    """Return Markdown whose relative links and pictures lead to a repository at a tag."""

    def link(found: re.Match[str]) -> str:
        kind = "raw" if found[1].startswith("!") else "blob"
        return f"{found[1]}({source}/{kind}/{tag}/{found[2]})"

    return re.sub(r"(!?\[[^\]]*\])\((?!\w+:|#)([^)]+)\)", link, text)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--sanitized"]:
        Path(sys.argv[2]).mkdir(parents=True, exist_ok=True)
        libraries = build(Path(sys.argv[2]), extra=SANITIZERS)
    else:
        libraries = build()
    if not libraries:
        sys.exit("no C++ compiler works here: install g++ or clang, or the Python package ziglang")
    print(*libraries, sep="\n")
else:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
    from hatchling.metadata.plugin.interface import MetadataHookInterface

    class Metadata(MetadataHookInterface):
        """hatchling's hook for what depends on the place of the repository."""

        def update(self, metadata: dict[str, Any]) -> None:
            """Add the description and the addresses."""
            source, site = os.environ.get("ROVER_NCP_SOURCE"), os.environ.get("ROVER_NCP_SITE")
            text = (Path(self.root) / "README.md").read_text()
            metadata["urls"] = {"Paper": PAPER}
            if source:
                text = with_addresses(text, source, f"v{metadata['version']}")
                metadata["urls"] |= {"Source": source, "Changelog": f"{source}/blob/HEAD/CHANGELOG.md"}
            if site:
                metadata["urls"]["Documentation"] = site
            metadata["readme"] = {"content-type": "text/markdown", "text": text}

    class NativeBuild(BuildHookInterface):  # type: ignore[type-arg]
        """hatchling's hook."""

        def dependencies(self) -> list[str]:
            """Return what a build needs: a compiler from an index where the machine has none."""
            needs_zig = "ROVER_NCP_TARGET" in os.environ or not compiler()
            return [ZIG_PACKAGE] if needs_zig and not os.environ.get("ROVER_NCP_PURE") else []

        def initialize(self, version: str, build_data: dict[str, Any]) -> None:
            """Build the libraries, and tag the wheel for its platform if there are any."""
            import sysconfig

            if os.environ.get("ROVER_NCP_PURE"):
                return
            if version == "editable":
                build()
                return
            # Not among the sources, which may be read-only or in use.
            self.folder = tempfile.TemporaryDirectory()
            target = os.environ.get("ROVER_NCP_TARGET")
            if not (libraries := build(Path(self.folder.name), target)):
                return
            platform_tag = target or sysconfig.get_platform().replace("-", "_").replace(".", "_")
            build_data["pure_python"] = False
            build_data["tag"] = f"py3-none-{platform_tag}"
            for library in libraries:
                build_data["force_include"][str(library)] = f"rover_ncp/native/{library.name}"
