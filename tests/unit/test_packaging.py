"""Files for robots, containers and GitHub: what their schemas, which ``make files`` checks, do not say."""

import re
import shlex
import shutil
import subprocess
import sys
import tomllib

import pytest
import yaml
from kit.command_lines import parse
from kit.paths import ROOT

PACKAGING = ROOT / "packaging"
COMPOSE = yaml.safe_load((PACKAGING / "compose.yaml").read_text())
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
USES = re.compile(r"uses: (\S+)(.*)")
TARGETS = re.findall(r"^([a-z-]+):(?!=)", (ROOT / "Makefile").read_text(), re.MULTILINE)
UNIT = (PACKAGING / "rover-ncp-bridge.service").read_text()


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.stem)
def test_actions_of_a_workflow_are_pinned_and_its_targets_exist(workflow):
    text = workflow.read_text()
    for action, comment in USES.findall(text):
        assert re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}", action), action
        assert re.fullmatch(r" # v\d+\.\d+\.\d+", comment), action
    for line in re.findall(r"run: make (.+)", text):
        assert set(line.split()) <= set(TARGETS)


def test_workflows_agree_on_the_version_of_an_action():
    pins = {pin for workflow in WORKFLOWS for pin in USES.findall(workflow.read_text())}
    assert len(pins) == len({action.partition("@")[0] for action, _ in pins})


def test_quick_tests_run_on_every_python_that_the_project_names():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    named = [
        re.fullmatch(r"Programming Language :: Python :: (3\.\d+)", each) for each in project["classifiers"]
    ]
    test = yaml.safe_load((ROOT / ".github" / "workflows" / "test.yml").read_text())["jobs"]["test"]
    assert test["strategy"]["matrix"]["python"] == [each[1] for each in named if each]


@pytest.mark.parametrize("service", COMPOSE["services"])
def test_a_service_of_the_compose_file_is_a_command(service):
    parse(f"rover-ncp {COMPOSE['services'][service]['command']}")


def test_image_has_a_lock_for_each_extra_that_is_named():
    text = (PACKAGING / "Dockerfile").read_text()
    extras = [*re.findall(r"EXTRA=(\w+)", text), COMPOSE["x-rover-ncp"]["build"]["args"]["EXTRA"]]
    for extra in extras:
        assert (ROOT / "requirements" / f"{extra}.txt").is_file()
    for source in re.findall(r"^COPY (?!--)([^$\n]+) \S+$", text, re.MULTILINE):
        assert all((ROOT / name).exists() for name in source.split())


def test_unit_starts_a_command_that_exists():
    [line] = re.findall(r"^ExecStart=\S+/(rover-ncp (?:.*\\\n)*.*)", UNIT, re.MULTILINE)
    parse(line)


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_accepts_the_unit(tmp_path):
    [program] = re.findall(r"^ExecStart=(\S+)", UNIT, re.MULTILINE)
    unit = tmp_path / "rover-ncp-bridge.service"
    unit.write_text(UNIT.replace(program, shlex.quote(sys.executable)))  # a program that is here
    done = subprocess.run(
        ["systemd-analyze", "verify", str(unit)], capture_output=True, text=True, check=False, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")
