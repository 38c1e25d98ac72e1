"""Mistakes on the command line, and files that cannot be: an exit code and one line, never a traceback."""

import os
import re
import shlex
import subprocess
import sys

import pytest
from kit.bnn_text import circuit_to_bnn
from kit.paths import DATA, ROOT
from kit.recorded_drives import write_drive

from rover_ncp.circuit.policy_file import load_circuit
from rover_ncp.cli import _app, get_command, run
from rover_ncp.wire.zenoh import CLIENT

LONG = "x" * 300
ROBOT = "--robot tcp/127.0.0.1:1"
BASE = "--base tcp/127.0.0.1:1"
SHORT = DATA / "short_course.yaml"

CAMERA, TAGS = (ROOT / "docs/examples" / name for name in ("camera.yaml", "tags.yaml"))
# The line of a command in which {} is an option and its value, or an argument, if only that one is wrong.
LINES = {
    "bridge": f"bridge {BASE} {{}}",
    "bridge --base-zenoh-config": "bridge --base ros2/tcp/127.0.0.1:1 --model husky-a200 {}",
    "check": f"check --on-blocks {ROBOT} {{}}",
    "course": "course check parking {}",
    "course --out": "course check parking {}.png",
    "course source": "course check {}",
    "deploy": f"deploy {ROBOT} {{}}",
    "eval": "eval course {}",
    "eval policy": "eval {}",
    "explain": "explain parking {}",
    "explain --runs": "explain --task mountain-car {}",
    "explain source": "explain {}",
    "export": "export parking --to c --out new {}",
    "export policy": "export {} --to c --out new",
    "identify": f"identify {ROBOT} {{}}",
    "identify --out": "identify drive.mcap {}",
    "identify recording": "identify {}",
    "mock --camera": f"mock {{}} --tags {TAGS}",
    "mock --tags": f"mock --camera {CAMERA} {{}}",
    "paper run": "paper run --task parking --agent circuit --seed 0 --again --budget quick {}",
    "paper report --curves": "paper report {}",
    "park --out": "park --policy parking {}",
    "place": f"place set new {ROBOT} {{}}",
    "recover --out": "recover drive.mcap {}",
    "report --out": "report drive.mcap {}",
    "tag calibrate": f"tag calibrate --camera none --camera-file {CAMERA} --map {TAGS} {{}}",
    "tag calibrate --camera-file": "tag calibrate --camera none {}",
    "tag calibrate --camera-info": "tag calibrate --camera none --camera-file new.yaml {}",
    "tag print --out": "tag print {}.pdf",
    "tag run": f"tag run --camera none --camera-file {CAMERA} --map {TAGS} {ROBOT} {{}}",
    "train --profile": "train --randomize mild {}",
    "watch": f"watch {ROBOT} --port 0 {{}}",
}
NAMES = {"policy", "course", "circuit", "model", "randomize", "source"}
"""Options and arguments that take a file besides a name; those of the type path take one anyway."""


def rows():
    """Yield a command line for each option and argument that takes a file."""
    group = get_command(_app())
    context = group.make_context("rover-ncp", [], resilient_parsing=True)
    commands = {name: group.get_command(context, name) for name in group.list_commands(context)}
    groups = {name: commands[name].commands for name in ("paper", "tag")}
    parts = {f"{name} {part}": command for name in groups for part, command in groups[name].items()}
    for name, command in {**commands, **parts}.items():
        if name == "teleop":  # it wants a terminal first
            continue
        for option in command.params:
            record = option.get_help_record(context)
            if record and ("<path>" in record[0] or option.name in NAMES):
                line = LINES.get(f"{name} {option.opts[0]}", LINES.get(name, f"{name} {{}}"))
                yield line.format(f"{option.opts[0]} {{}}" if option.opts[0][0] == "-" else "{}")


FILES = sorted({*rows(), "train --resume --out {}", "course new {}.csv --out new.yaml"})
TABLE = [
    *((line.format(LONG), "File name too long") for line in FILES),
    *((line.format("file/x"), "file/x") for line in FILES),
    # recordings and runs that exist
    (f"deploy {ROBOT} --record drive.mcap", "drive.mcap: exists already"),
    (f"identify {ROBOT} --record drive.mcap", "drive.mcap: exists already"),
    ("recover drive.mcap --out file", "file: exists already"),
    ("report drive.mcap --out drive.mcap", "drive.mcap: is a recording; choose another file"),
    ("identify drive.mcap --out drive.mcap", "drive.mcap: is a recording; choose another file"),
    ("mock --truth file", "file: exists already"),
    # hand-written files that a result would replace
    (
        "identify drive.mcap --out robot.yaml",
        "robot.yaml: exists and is not a robot profile; choose another file",
    ),
    (f"identify {ROBOT} --out poses.yaml", "poses.yaml: exists and is not a robot profile"),
    ("course new poses.yaml --out poses.yaml", "poses.yaml: is the command's own input; choose another file"),
    ("course new poses.yaml --out robot.yaml", "robot.yaml: exists and is not a course"),
    ("course check parking --out notes.png", "notes.png: exists and is not a picture"),
    ("report drive.mcap --out robot.yaml", "robot.yaml: exists and is not a page (HTML)"),
    ("tag print --out notes.pdf", "notes.pdf: exists and is not a PDF"),
    ("export ./forward.yaml --to yaml --out .", "forward.yaml: is the command's own input"),
    ("export FORWARD --to yaml --out written", "written/forward.yaml: exists and is not a policy"),
    (f"deploy {ROBOT} --record robot.yaml --overwrite", "robot.yaml: exists and is not a recording"),
    ("recover drive.mcap --out robot.yaml --overwrite", "robot.yaml: exists and is not a recording"),
    ("park --dock --out docked", "docked/tags.yaml: exists already; choose another file, or use --overwrite"),
    ("park --policy parking --out done", "done/run.mcap: exists already"),
    ("park --out done", "done/run.mcap: exists already"),
    ("park --policy task.yaml --out none", "policy wall"),
    ("park --policy parking --out last", "last/trajectory.png: cannot be written"),
    ("park --dock --out last", "last/view.jpg: cannot be written"),
    ("explain parking --out last", "last/explanation.json: cannot be written: Is a directory"),
    ("export parking --to c --out last", "last/parking_check.c: cannot be written: Is a directory"),
    ("park --out trained", "trained/train: exists already"),
    ("train --resume --out done", "done: holds no training run to resume"),
    # YAML and courses
    ("course check deep.yaml", "more than 100 lists or mappings in each other"),
    (f"bridge {BASE} --limits deep.yaml", "more than 100 lists or mappings in each other"),
    ("course check long.yaml", "expected 1048576 at most"),
    ("course check many.yaml", "at most 1000 items"),
    ("course check far.yaml", "$.checkpoints[0].x: input should be less than or equal to 1000, got 1e+300"),
    ("course new far.csv --out new.yaml", "$.poses[1].x: input should be less than or equal to 1000"),
    ("course new slow.csv --out new.yaml", "$.horizon_s: input should be less than or equal to 3600"),
    ("course check /dev/zero", "/dev/zero: is a device or pipe, expected a file"),
    ("train --course blocked.yaml", "an obstacle stands where the rover starts"),
    ("eval course --course blocked.yaml", "an obstacle stands where the rover starts"),
    ("eval course --course typo.yaml", "$.horizon: unknown key"),
    ("course check poses.yaml", "$.checkpoints: this key is missing; $.poses: unknown key"),
    # circuits and policies
    ("eval small.bnn", "small.bnn: to drive a rover it needs at least 12 neurons"),
    ("eval damaged.bnn", "damaged.bnn"),
    ("eval nan.bnn", "nan.bnn"),
    ("eval empty.bnn", "empty.bnn: the file is empty"),
    ("eval typo.yaml", "typo.yaml: $.format: this key is missing; $.circuit: this key is missing"),
    ("eval parking.bnn --task mountain-car", "'REV'"),
    ("train --randomize full --circuit parking", "no neuron 'REV'"),
    ("train --randomize full --circuit parking --refine", "parking is an untrained circuit"),
    ("train --circuit smell.yaml", "policy forward: unknown signals: smell (expected some of x, "),
    ("train --task CartPole-v1 --circuit parking", "a task needs a policy file"),
    ("eval kanayama --task mountain-car", "kanayama follows a course"),
    ("eval task.yaml --task Nowhere-v0", "no task Nowhere-v0: it is none of pendulum"),
    ("eval task.yaml --task CartPole-v1", "rover-ncp: environment CartPole-v1: its observation has 4"),
    # other files
    ("train --out done", "is not empty"),
    ("train --randomize full --out done", "is not empty"),
    ("train --out /proc/nowhere", "/proc/nowhere: cannot be used as a folder"),
    ("recover empty.mcap", "the file is empty"),
    ("replay file", "not an MCAP recording"),
    ("explain noise.mcap", "not an MCAP recording"),
    (f"bridge {BASE} --zenoh-config zenoh.json5", "zenoh.json5: not a Zenoh configuration: "),
    (f"deploy {ROBOT} --zenoh-config deep.json5", "deep.json5: not a Zenoh configuration: more than 100"),
    (f"deploy {ROBOT} --zenoh-config zenoh.json5", "zenoh.json5: not a Zenoh configuration: "),
    (f"bridge {BASE} --limits fast.yaml", "$.v_max: input should be less than or equal to 1.2, got 3.0"),
    (f"bridge {BASE} --limits unknown.yaml", "$.speed: unknown key"),
    (f"bridge {BASE} --zenoh-config listen.json5 --insecure", "tcp/192.0.2.1:9: cannot listen there"),
    ("eval course --randomize ranges.yaml", "less than 1, got 1.5; $.start: unknown key"),
    ("eval course --profile profile.yaml", "less than 5, got 99; $.delay: unknown key"),
    # names
    ("fly", "No such command 'fly'"),
    ("evla", "Did you mean 'eval'"),
    ("train --agens 3", "--agens"),
    ("train --course prking", "prking: no such file, and none of the shipped courses ("),
    ("train --circuit tap_withdrawal", "RGT"),
    ("train --randomize wild", "none of the shipped randomizations"),
    ("eval missing", "missing: no such file, and none of the shipped policies"),
    ("eval course --course nowhere", "nowhere: no such file, and none of the shipped courses"),
    ("eval small.bnn --task car", "no task"),
    ("paper run --task cart", "no task 'cart'"),
    (f"deploy {ROBOT} --policy unheard-of", "unheard-of: no such file, and none of the shipped"),
    (f"bridge {BASE} --model hal", "hal: no such file, and none of the shipped robots"),
    # options that do not go together
    ("train --resume", "--resume needs --out"),
    ("train --cluster tcp://127.0.0.1:9 --processes 2", "do not go together"),
    ("paper run --cluster tcp://127.0.0.1:9 --processes 2", "--cluster cannot be combined with --processes"),
    ("train --randomize full --agents 3", "--randomize and --agents do not go together"),
    ("train --randomize full --rollouts 3 --worst 4", "the worst 4 of 3 rollouts"),
    ("eval course --trials 2 --stack --randomize varied", "mujoco, expected one for pymunk"),
    ("eval course --trials 2 --stack --body mujoco --randomize full", "pymunk, expected one for mujoco"),
    ("eval course --model nogyro.yaml --stack --body mujoco", "four wheels; nogyro has two"),
    ("eval course --model nogyro.yaml --stack --sensors gyro", "nogyro has no gyro"),
    ("eval small.bnn --task parking", "without --task"),
    ("eval small.bnn --task mountain-car --course bay", "alone"),
    ("identify", "expected either --robot"),
    (f"identify drive.mcap {ROBOT}", "expected either --robot"),
    (f"check {ROBOT}", "put the robot on blocks"),
    # options without an effect
    ("mock --namespace bot1", "--namespace: needs --ros2"),
    ("mock --ros rmw-zenoh", "--ros: needs --ros2"),
    ("mock --ros2 --model turtlebot4 --gyro", "--gyro"),
    ("mock --overwrite", "--overwrite: needs --truth"),
    ("train --rollouts 3", "--rollouts needs --randomize or --task"),
    ("eval course --range a=1", "--range: needs --task"),
    ("eval course --trials 2 --body mujoco", "needs --stack"),
    ("eval course --trials 2 --sensors gyro", "--sensors needs --stack"),
    ("eval course --trials 2 --identify", "--identify needs --stack"),
    ("eval course --processes 2", "--processes needs --stack"),
    ("eval mine.bnn --task mountain-car --stack", "--stack: --task goes with"),
    ("eval mine.bnn --task mountain-car --body mujoco", "--body: --task goes with"),
    ("eval mine.bnn --task mountain-car --model p3dx --processes 2", "--model, --processes: --task"),
    ("paper report --seed 0", "No such option: --seed"),
    ("explain parking --runs new", "--runs: needs --task"),
    ("explain parking --task mountain-car --runs new", "--runs: needs --task, without a policy"),
    (f"deploy {ROBOT} --overwrite", "--overwrite: needs --record"),
    (f"teleop {ROBOT} --overwrite", "--overwrite: needs --record"),
    (f"identify {ROBOT} --overwrite", "--overwrite: needs --record"),
    ("identify drive.mcap --fence 0.5 --namespace a", "--fence, --namespace: needs --robot"),
    ("recover drive.mcap --overwrite", "--overwrite: needs --out"),
    ("course new poses.csv --out new.yaml --model p3dx", "--model: is for check"),
    ("course check parking --name mine", "--name: is for new"),
    ("course new poses.csv", "--out: expected the new course's file"),
    ("course new poses.csv --out course.png", "--out: expected the new course's file"),
    ("course new poses.csv --out x.yaml --name 'Big Bay'", "--name Big Bay"),
    ("course check parking --out x.pdf", "expected a picture"),
    ("course look parking", "look"),
    ("export parking --to yaml --out new --course bay", "--course: --to yaml needs no course"),
    (f"bridge {BASE} --no-base-watchdog", "--no-base-watchdog: is for a ROS 2 robot"),
    # values
    ("eval", "Missing argument"),
    ("eval course --randomize ''", "an empty name"),
    ("eval small.bnn --task mountain-car --range speed=1", "senses position, velocity"),
    ("eval small.bnn --task mountain-car --range position=x", "NAME=LIMIT"),
    ("eval small.bnn --task mountain-car --range position=-1", "above 0"),
    (f"deploy {ROBOT} --duration nan", "'--duration'"),
    (f"deploy {ROBOT} --duration inf", "--duration inf: expected seconds"),
    (f"deploy {ROBOT} --namespace 'a b'", "namespace 'a b'"),
    (f"bridge {BASE} --namespace 'a*'", "namespace 'a*'"),
    ("deploy --robot 192.168.1.20", "--robot 192.168.1.20: expected PROTOCOL/HOST[:PORT]"),
    ("bridge --base ftp/x", "base ftp/x: expected tcp/HOST"),
    (f"bridge {BASE} --listen garbage", "expected PROTOCOL/HOST:PORT, like tcp/127.0.0.1:7447"),
    (f"bridge {BASE} --listen tcp/127.0.0.1", "tcp/127.0.0.1: cannot listen there: invalid socket address"),
    *(
        (f"bridge {BASE} {options}", ": any client that reaches it could drive the rover")
        for options in (
            *("--listen tcp/192.0.2.1:0", "--listen tcp/0.0.0.0:0", "--listen tcp/[::]:0"),
            *("--listen tls/0.0.0.0:0", "--listen tcp/127.0.0.1:0 --zenoh-config connect.json5"),
        )
    ),
    ("deploy --robot tcp/127.0.0.1:99999", "expected a port from 1 to 65535"),
    ("deploy --robot tcp/127.0.0.1:0", "expected a port from 1 to 65535"),
    ("bridge --base tcp/127.0.0.1:99999 --listen tcp/127.0.0.1:0", "99999"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with files that no command can use, or may replace."""
    folder = tmp_path_factory.mktemp("errors")
    for name in ("file", "noise.mcap"):
        (folder / name).write_text("not a recording")
    write_drive(folder / "drive.mcap", course=SHORT)
    for made in ("done/run.mcap", "trained/train/settings.yaml", "docked/tags.yaml", "written/forward.yaml"):
        (folder / made).parent.mkdir(parents=True)
        (folder / made).write_text("x")
    for name in ("trajectory.png", "view.jpg", "explanation.json", "parking_check.c"):
        (folder / "last" / name).mkdir(parents=True)
    row = "- {{t: {}, x: {}, y: 0, theta: 0}}\n"
    head = "name: a\nstart_signal_s: 0\nhorizon_s: 3600\ncheckpoints:\n"
    short, parking = SHORT.read_text(), circuit_to_bnn(load_circuit("parking"))
    forward = (ROOT / "docs/examples/policy.yaml").read_text()
    tutorial = (ROOT / "docs/tutorials/own_task.md").read_text()
    written = {
        "deep.yaml": "a: " + "[" * 100_000 + "]" * 100_000,
        "long.yaml": head + "".join(row.format(0.01 * k, 0) for k in range(100_000)),
        "many.yaml": head + "".join(row.format(k, 0) for k in range(1001)),
        "far.yaml": head + row.format(1, "1.0e+300"),
        "blocked.yaml": short + "obstacles: [{x: 0.2, y: 0, length: 0.1, width: 0.1}]\n",
        "typo.yaml": short.replace("horizon_s", "horizon"),
        "poses.yaml": "poses:\n- {x: 0, y: 0, theta: 0}\n- {x: 1, y: 0, theta: 0}\n",
        "robot.yaml": "name: mine\nbased_on: turtlebot4\n",
        "notes.png": "by hand",
        "notes.pdf": "by hand",
        "forward.yaml": forward,
        "FORWARD": forward,
        "poses.csv": "x,y,theta\n0,0,0\n1,0,0\n",
        "far.csv": "x,y,theta\n0,0,0\n1e300,0,0\n",
        "slow.csv": "x,y,theta\n0,0,0\n900,0,0\n",
        "parking.bnn": parking,
        "small.bnn": circuit_to_bnn(load_circuit("tap_withdrawal")),
        "damaged.bnn": parking.replace("size 12", "size twelve"),
        "nan.bnn": parking + "cm 3 nan\n",
        "empty.bnn": "",
        "empty.mcap": "",
        "smell.yaml": re.sub("(inputs: .|name: )x([],])", r"\1smell\2", forward),
        "task.yaml": re.search(r'title="wall.yaml"\n(.*?)```', tutorial, re.DOTALL)[1],
        "nogyro.yaml": "name: nogyro\nbased_on: turtlebot4\ngyro: null\n",
        "ranges.yaml": "name: bad\nlost: 1.5\nstart: 3\n",
        "profile.yaml": "name: x\ngain_v: 99\ndelay: 1\n",
        "zenoh.json5": '{ mode: "client", no_such_key: 1 }',
        "deep.json5": "{a: " + "[" * 200_000 + "]" * 200_000 + "}",
        "listen.json5": '{ listen: { endpoints: ["tcp/192.0.2.1:9"] } }',
        "connect.json5": '{ connect: { endpoints: ["tcp/0.0.0.0:0"] } }',
        "fast.yaml": "v_max: 3.0",
        "unknown.yaml": "speed: 1",
    }
    for name, text in written.items():
        (folder / name).write_text(text)
    return folder


def files(folder):
    """Return all folders, and when each file was changed last."""
    return {str(path): path.is_file() and path.stat().st_mtime_ns for path in folder.rglob("*")}


@pytest.mark.parametrize(("command", "words"), TABLE, ids=lambda text: text.replace(LONG, "LONG"))
def test_a_mistake_is_one_line_and_exit_code_2_before_any_work(command, words, folder, monkeypatch, capfd):
    monkeypatch.chdir(folder)
    before = files(folder)
    assert run(shlex.split(command)) == 2
    printed = capfd.readouterr()
    assert printed.err.startswith("rover-ncp: ")
    assert printed.err.count("\n") == 1
    assert words in printed.err
    assert printed.out == ""
    assert files(folder) == before


@pytest.mark.parametrize(
    "command", ["check --on-blocks", "deploy", "identify --out new.yaml", "watch --port 0"]
)
def test_no_bridge_is_one_line_and_exit_code_3(command, folder, monkeypatch, capfd):
    monkeypatch.chdir(folder)
    monkeypatch.setitem(CLIENT, "connect/timeout_ms", 100)
    before = files(folder)
    assert run(shlex.split(f"{command} {ROBOT}")) == 3
    assert "nothing answers at tcp/127.0.0.1:1" in capfd.readouterr().err
    assert files(folder) == before


def test_deploy_announces_long_planning_for_a_policy_that_follows_the_course(monkeypatch, capfd):
    monkeypatch.setitem(CLIENT, "connect/timeout_ms", 100)
    for policy, announced in (("course", True), ("parking", False)):
        assert run(shlex.split(f"deploy {ROBOT} --course longer --policy {policy}")) == 3
        assert ("planning the reference of longer" in capfd.readouterr().out) == announced


@pytest.mark.parametrize("command", ["course check mine.yaml", "keys --out mine", "report drive.mcap"])
def test_a_working_directory_that_is_gone_is_one_line(command, tmp_path, monkeypatch, capfd):
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    assert run(shlex.split(command)) == 2
    printed = capfd.readouterr().err
    assert printed.count("\n") == 1
    assert "no such file" in printed.lower()


# Root may search and write any folder, unless it gives up the capabilities for it.
AS_ANYBODY = ["setpriv", "--bounding-set=-dac_override,-dac_read_search"] if os.geteuid() == 0 else []


RUN_EACH = "import sys; from rover_ncp.cli import run; print([run(line.split()) for line in sys.argv[1:]])"


def test_mistake_that_only_a_process_shows_is_one_line(tmp_path):
    """A folder that may not be searched; standard input that is no terminal."""
    (tmp_path / "locked").mkdir(mode=0)
    commands = ["course check locked/mine", "keys --out locked/mine", f"teleop {ROBOT}"]
    done = subprocess.run(
        [*AS_ANYBODY, sys.executable, "-c", RUN_EACH, *commands],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        stdin=subprocess.DEVNULL,
    )
    assert done.stdout == "[2, 2, 2]\n"
    *denied, terminal = done.stderr.splitlines()
    assert len(denied) == 2
    assert all("Permission denied" in line for line in denied)
    assert "expected a terminal as standard input" in terminal
