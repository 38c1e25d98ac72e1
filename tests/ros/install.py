"""Make the environment of the tests with ROS 2; exit 0 if it is there, 77 with one line if it cannot be had.

It is apart from the project's: its ``.pth`` file starts Python again with a library path that children inherit.
"""

import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

REQUIREMENTS = Path(__file__).with_name("requirements.txt")
SKIPPED = 77


def main():
    folder = Path(sys.argv[1])
    done = folder / "installed.txt"
    wanted = REQUIREMENTS.read_text()
    if done.is_file() and done.read_text() == wanted:
        return 0
    own = sys.executable if sys.version_info[:2] == (3, 11) else None
    python = own or shutil.which("python3.11")
    machine = f"{platform.system()} {platform.machine()}"
    if machine != "Linux x86_64" or python is None:
        here = machine if python else f"{machine}, no python3.11"
        return skipped(f"ROS 2's wheels are for CPython 3.11 on Linux x86_64; here: {here}")
    shutil.rmtree(folder, ignore_errors=True)
    subprocess.run([python, "-m", "venv", folder], check=True)
    pip = [folder / "bin" / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    made = subprocess.run(
        [*pip, "-r", REQUIREMENTS],
        env=os.environ | {"_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"},
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    if made.returncode == 0:
        done.write_text(wanted)
        return 0
    sys.stderr.write(made.stderr)
    if "No matching distribution" in made.stderr:
        return skipped("the package index here does not have ROS 2's wheels")
    return 1


def skipped(why):
    print(f"make test-ros: skipped: {why}")
    return SKIPPED


if __name__ == "__main__":
    sys.exit(main())
