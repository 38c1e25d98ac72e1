"""Make the environment of the tests with ROS 2; exit 77 with one line if this machine cannot have it.

It is apart from the project's: its ``.pth`` file starts Python again with a library path, which children
inherit.
"""

import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

REQUIREMENTS = Path(__file__).with_name("requirements.txt")
SKIPPED = 77
COMPILE = "from pyzeros.builtin_msgs import Attachment; Attachment().serialize()"


def main():
    folder = Path(sys.argv[1]).resolve()
    done = folder / "installed.txt"
    wanted = REQUIREMENTS.read_text()
    if done.is_file() and done.read_text() == wanted:
        return 0
    ours = sys.executable if sys.version_info[:2] == (3, 11) else None
    python = ours or shutil.which("python3.11")
    machine = f"{platform.system()} {platform.machine()}"
    if machine != "Linux x86_64" or python is None:
        here = machine if python else f"{machine}, no python3.11"
        return skipped(f"ROS 2's wheels are for CPython 3.11 on Linux x86_64; here: {here}")
    if shutil.which("gcc") is None:
        print("make test-ros: pyzeros compiles its codecs: apt-get install gcc libc6-dev", file=sys.stderr)
        return 1
    shutil.rmtree(folder, ignore_errors=True)
    subprocess.run([python, "-m", "venv", folder], check=True)
    own = folder / "bin" / "python"
    pip = [own, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-r", REQUIREMENTS]
    made = subprocess.run(pip, stderr=subprocess.PIPE, text=True, check=False)
    if made.returncode != 0:
        sys.stderr.write(made.stderr)
        if "No matching distribution" in made.stderr:
            return skipped("the package index does not have ROS 2's wheels")
        return 1
    # Half a minute of a compiler, which no test has to wait for.
    environment = os.environ | {"CYDR_CACHE_DIR": str(folder / "cydr")}
    subprocess.run([own, "-c", COMPILE], check=True, env=environment)
    done.write_text(wanted)
    return 0


def skipped(why):
    print(f"make test-ros: skipped: {why}")
    return SKIPPED


if __name__ == "__main__":
    sys.exit(main())
