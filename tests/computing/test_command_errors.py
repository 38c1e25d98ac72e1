"""Mistakes on the command line, and files that cannot be: an exit code and one line, never a traceback."""

import os
import re
import shlex
import subprocess
import sys

import pytest
from kit.paths import DATA, ROOT
from kit.recorded_drives import write_drive

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
    "explain source": "explain {}",
    "export": "export parking --to c --out new {}",
    "export policy": "export {} --to c --out new",
    "identify": f"identify {ROBOT} {{}}",
    "identify --out": "identify drive.mcap {}",
    "identify recording": "identify {}",
    "mock --camera": f"mock {{}} --tags {TAGS}",
    "mock --tags": f"mock --camera {CAMERA} {{}}",
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
    groups = {name: commands[name].commands for name in ("tag",)}
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
OUTPUTS = [
    f"deploy {ROBOT} --record drive.mcap",
    f"identify {ROBOT} --out poses.yaml",
    "identify drive.mcap --out poses.yaml",
    "recover drive.mcap --out file",
    "report drive.mcap --out notes",
    "mock --truth file",
    "course new poses.csv --out poses.yaml",
    "course check parking --out notes.png",
    "tag print --out notes.pdf",
    "export FORWARD --to yaml --out written",
    "explain parking --out written",
    "park --dock --out written",
    "park --policy parking --out done",
    "park --out done",
    "park --out trained",
]
"""Commands whose result would replace a file."""
OPTIONS = [
    "train --agens 3",
    "train --resume",
    "train --cluster tcp://127.0.0.1:9 --processes 2",
    "train --randomize full --agents 3",
    "train --rollouts 3",
    "eval course --processes 2",
    "identify",
    f"identify drive.mcap {ROBOT}",
    f"identify drive.mcap {ROBOT} --fence 0.5",
    "identify drive.mcap --fence 0.5",
    f"check {ROBOT}",
    "mock --namespace bot1",
    "mock --ros2 --model turtlebot4 --gyro",
    "mock --overwrite",
    "recover drive.mcap --overwrite",
    "course new poses.csv --out new.yaml --model p3dx",
    "course check parking --name mine",
    "course new poses.csv",
    "course new poses.csv --out x.yaml --name 'Big Bay'",
    "course check parking --out x.pdf",
    "export parking --to yaml --out new --course bay",
    f"bridge {BASE} --no-base-watchdog",
    f"deploy {ROBOT} --duration nan",
    f"deploy {ROBOT} --duration inf",
    "deploy --robot 192.168.1.20",
]
"""Commands whose options are unknown, wrong, without effect, or do not go together."""
TABLE = [
    *((line.format(LONG), "File name too long") for line in FILES),
    *((line.format("file/x"), "file/x") for line in FILES),
    *((line, ": exists already; choose another") for line in OUTPUTS),
    *((line, "--") for line in OPTIONS),
    # the last file of several cannot be written: none is
    ("park --policy parking --out last", "last/trajectory.png: cannot be written"),
    ("explain parking --out last", "last/explanation.json: cannot be written: Is a directory"),
    ("export parking --to c --out last", "last/parking_check.c: cannot be written: Is a directory"),
    # files that hold something else
    ("train --resume --out done", "done: holds no training run to resume"),
    ("train --out done", "is not empty"),
    ("train --out /proc/nowhere", "/proc/nowhere: cannot be used as a folder"),
    ("replay file", "not an MCAP recording"),
    ("explain noise.mcap", "not an MCAP recording"),
    ("recover empty.mcap", "the file is empty"),
    ("course check /dev/zero", "/dev/zero: is a device or pipe, expected a file"),
    (f"bridge {BASE} --limits deep.yaml", "more than 100 lists or mappings in each other"),
    ("course check many.yaml", "at most 1000 items"),
    ("course check far.yaml", "$.checkpoints[0].x: input should be less than or equal to 1000, got 1e+300"),
    ("course new slow.csv --out new.yaml", "$.horizon_s: input should be less than or equal to 3600"),
    ("eval course --course blocked.yaml", "an obstacle stands where the rover starts"),
    ("eval course --course typo.yaml", "$.horizon: unknown key"),
    ("eval typo.yaml", "typo.yaml: $.format: this key is missing; $.circuit: this key is missing"),
    ("train --circuit smell.yaml", "policy forward: unknown signals: smell (expected some of x, "),
    (f"deploy {ROBOT} --zenoh-config deep.json5", "deep.json5: not a Zenoh configuration: more than 100"),
    (f"bridge {BASE} --zenoh-config zenoh.json5", "zenoh.json5: not a Zenoh configuration: "),
    (f"bridge {BASE} --zenoh-config listen.json5 --insecure", "tcp/192.0.2.1:9: cannot listen there"),
    (f"bridge {BASE} --limits fast.yaml", "$.v_max: input should be less than or equal to 1.2, got 3.0"),
    ("eval course --profile profile.yaml", "less than 5, got 99; $.delay: unknown key"),
    # names and addresses
    ("evla", "Did you mean 'eval'"),
    ("eval", "Missing argument"),
    ("eval course --randomize ''", "an empty name"),
    ("eval missing", "missing: no such file, and none of the shipped policies"),
    (f"deploy {ROBOT} --namespace 'a b'", "namespace 'a b'"),
    ("deploy --robot tcp/127.0.0.1:99999", "expected a port from 1 to 65535"),
    ("bridge --base ftp/x", "base ftp/x: expected tcp/HOST"),
    (f"bridge {BASE} --listen garbage", "expected PROTOCOL/HOST:PORT, like tcp/127.0.0.1:7447"),
    *(
        (f"bridge {BASE} {options}", ": any client that reaches it could drive the rover")
        for options in (
            *("--listen tcp/192.0.2.1:0", "--listen tcp/0.0.0.0:0", "--listen tcp/[::]:0"),
            *("--listen tls/0.0.0.0:0", "--listen tcp/127.0.0.1:0 --zenoh-config connect.json5"),
        )
    ),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with files that no command can use, or may replace."""
    folder = tmp_path_factory.mktemp("errors")
    for name in ("file", "noise.mcap"):
        (folder / name).write_text("not a recording")
    write_drive(folder / "drive.mcap", course=SHORT)
    for made in ("done/run.mcap", "trained/train/settings.yaml"):
        (folder / made).parent.mkdir(parents=True)
        (folder / made).write_text("x")
    for name in ("trajectory.png", "explanation.json", "parking_check.c"):
        (folder / "last" / name).mkdir(parents=True)
    row = "- {{t: {}, x: {}, y: 0, theta: 0}}\n"
    head = "name: a\nstart_signal_s: 0\nhorizon_s: 3600\ncheckpoints:\n"
    short, forward = SHORT.read_text(), (ROOT / "docs/examples/policy.yaml").read_text()
    written = {
        "deep.yaml": "a: " + "[" * 100_000 + "]" * 100_000,
        "many.yaml": head + "".join(row.format(k, 0) for k in range(1001)),
        "far.yaml": head + row.format(1, "1.0e+300"),
        "blocked.yaml": short + "obstacles: [{x: 0.2, y: 0, length: 0.1, width: 0.1}]\n",
        "typo.yaml": short.replace("horizon_s", "horizon"),
        "poses.yaml": "poses:\n- {x: 0, y: 0, theta: 0}\n- {x: 1, y: 0, theta: 0}\n",
        **dict.fromkeys(("notes", "notes.png", "notes.pdf"), "by hand"),
        "FORWARD": forward,
        "poses.csv": "x,y,theta\n0,0,0\n1,0,0\n",
        "slow.csv": "x,y,theta\n0,0,0\n900,0,0\n",
        "empty.mcap": "",
        "smell.yaml": re.sub("(inputs: .|name: )x([],])", r"\1smell\2", forward),
        "profile.yaml": "name: x\ngain_v: 99\ndelay: 1\n",
        "zenoh.json5": '{ mode: "client", no_such_key: 1 }',
        "deep.json5": "{a: " + "[" * 200_000 + "]" * 200_000 + "}",
        "listen.json5": '{ listen: { endpoints: ["tcp/192.0.2.1:9"] } }',
        "connect.json5": '{ connect: { endpoints: ["tcp/0.0.0.0:0"] } }',
        "fast.yaml": "v_max: 3.0",
        **dict.fromkeys(("written/forward.yaml", "written/explanation.html", "written/tags.yaml"), "by hand"),
    }
    (folder / "written").mkdir()
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
