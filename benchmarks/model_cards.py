"""Success of the shipped policies by condition, for their model cards.

    python -m benchmarks.model_cards

runs the commands of ``CONDITIONS``, with a seed that no policy was trained or chosen with, and writes what
they found into ``benchmarks/models.json``. ``--only TEXT`` repeats those whose command has the text. ``make
reference`` makes the page of it. All together take ten minutes of CPU time.
"""

import argparse
import json
import shlex
import subprocess
import sys
from pathlib import Path

RESULTS = Path(__file__).with_name("models.json")
PLAIN = "--trials 1000 --seed 2026"
MUJOCO = "--trials 50 --seed 2026 --stack --body mujoco --randomize varied"
CONDITIONS = {
    "course": {
        "start within 5 cm and 5°": f"eval course {PLAIN} --randomize mild",
        "start within 10 cm and 10°": f"eval course {PLAIN} --randomize full",
        "lost commands, wheel mismatch, a push": f"eval course {PLAIN} --randomize harsh",
        "skid-steer, pose from a localiser": f"eval course {PLAIN} --randomize skid",
        "as refined: the same, start within 30 cm and 17°": f"eval course {PLAIN} --randomize far",
        "mirrored course": f"eval course --course mirrored {PLAIN} --randomize full",
        "course bay": f"eval course --course bay {PLAIN} --randomize full",
        "course longer": f"eval course --course longer {PLAIN} --randomize full",
        "200 random courses": f"eval course {PLAIN} --randomize full --random-courses 200",
        "MuJoCo, level floor, encoders alone": f"eval course {MUJOCO} --sensors encoders",
        "MuJoCo, level floor, gyro": f"eval course {MUJOCO} --sensors gyro",
    },
    "dock": {
        "as trained: start within 10 cm and 10°": f"eval dock --course approach {PLAIN} --randomize docking",
    },
    "parking": {
        "as trained: the nominal rover": "eval parking --trials 1 --randomize none",
        "start within 5 cm and 5°": f"eval parking {PLAIN} --randomize mild",
        "start within 10 cm and 10°": f"eval parking {PLAIN} --randomize full",
    },
    "reverse": {
        "as trained: the nominal rover": "eval reverse --course reverse --trials 1 --randomize none",
        "start within 5 cm and 5°": f"eval reverse --course reverse {PLAIN} --randomize mild",
        "start within 10 cm and 10°": f"eval reverse --course reverse {PLAIN} --randomize full",
    },
}
"""By policy, the conditions and the command that measures each."""
KEPT = ("trials", "success_rate", "success_ci95", "error_m", "error_rad", "failures")


def measure(command: str) -> dict[str, object]:
    """Run one command, and return the fields of its JSON that the cards need."""
    words = [sys.executable, "-m", "rover_ncp", *shlex.split(command), "--json"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1):
        raise SystemExit(done.stderr)
    found = json.loads(done.stdout)
    return {name: found[name] for name in KEPT if name in found}


def main() -> None:
    """Measure from the command line."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("--only", default="")
    only = options.parse_args().only
    known = json.loads(RESULTS.read_text()) if RESULTS.is_file() else {}
    for command in (command for rows in CONDITIONS.values() for command in rows.values()):
        if command not in known or (only and only in command):
            known[command] = measure(command)
            print(f"{known[command]['success_rate']:7.1%} {command}", flush=True)
            RESULTS.write_text(json.dumps(known, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
