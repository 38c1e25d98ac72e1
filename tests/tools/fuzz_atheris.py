"""Fuzzing guided by branch coverage: ``python tests/tools/fuzz_atheris.py [READER...]``, or ``make fuzz``.

Each reader of ``fuzz_readers.py`` runs in a process of its own, all together for FUZZ_S seconds (60), and
begins with its samples. What it finds, and what crashed, stays in ``runs/fuzz``; the next run goes on from
there.
"""

import os
import subprocess
import sys
from pathlib import Path

import atheris

sys.path.insert(0, str(Path(__file__).parents[1]))
with atheris.instrument_imports(include=["bridge", "deploy", "rover_ncp"]):
    from kit.fuzz_readers import READERS, survives

FOLDER = Path(__file__).parents[2] / "runs" / "fuzz"
LONGEST = 20_000
HANGS_S, MEMORY_MB = 20, 2048


def fuzz(name, seconds):
    """Fuzz one reader; does not return."""
    found, crashed = FOLDER / name, FOLDER / f"{name}-crashed"
    for folder in (found, crashed):
        folder.mkdir(parents=True, exist_ok=True)
    for number, sample in enumerate(READERS[name].samples()):
        (found / f"sample-{number}").write_bytes(sample)
    options = [f"-max_total_time={seconds}", f"-max_len={LONGEST}", f"-timeout={HANGS_S}"]
    options += [
        f"-rss_limit_mb={MEMORY_MB}",
        f"-artifact_prefix={crashed}/",
        "-print_final_stats=1",
        "-verbosity=0",
    ]
    atheris.Setup([sys.argv[0], *options, str(found)], lambda data: survives(READERS[name], data))
    atheris.Fuzz()


def main(names):
    seconds = max(int(os.environ.get("FUZZ_S", "60")) // len(names), 1)
    failed = []
    for name in names:
        print(f"{name}: {seconds} s", flush=True)
        command = [sys.executable, __file__, "--one", name, str(seconds)]
        if subprocess.run(command, check=False).returncode:
            failed.append(name)
    print(f"{len(names)} readers, " + (f"failed: {', '.join(failed)}" if failed else "none failed"))
    return 1 if failed else 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        fuzz(sys.argv[2], int(sys.argv[3]))
    sys.exit(main(sys.argv[1:] or list(READERS)))
