import json

import numpy as np
import pytest
from kit.recorded_drives import write_drive

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.cli import run
from rover_ncp.course.course import load_course
from sim.explain.explain import explain
from sim.explain.what_if import without_synapse
from sim.learn.rollout import rollout

SHORT = "tests/data/short_course.yaml"


@pytest.fixture(scope="module")
def parking():
    return load_policy("parking")


@pytest.fixture(scope="module")
def explained():
    return explain("parking", SHORT)


def test_knock_outs_are_the_drives_without_each_part(parking, explained):
    course = load_course(SHORT)
    intact = rollout(parking, course)
    found = explained.knock_outs
    assert [row.kind for row in found] == ["neuron"] * 12 + ["synapse"] * 30
    by_name = {row.name: row for row in found}
    # Nothing moves forward without FWD.
    assert by_name["FWD"].error_m == pytest.approx(np.hypot(course.goal.x, course.goal.y), abs=1e-6)
    assert by_name["FWD"].change == by_name["FWD"].total - intact.total
    both = rollout(without_synapse(parking, 27), course)
    assert by_name[parking.circuit.label(27)].total == both.total


@pytest.mark.long
def test_command_writes_files_and_json_and_a_recording_is_explained_alike(tmp_path, capsys):
    out = tmp_path / "out"
    assert run(["explain", "parking", "--course", SHORT, "--out", str(out), "--json"]) == 0
    said = capsys.readouterr()
    fields = json.loads(said.out)
    assert len(fields["contributions"]) == 9 * 3
    assert json.loads((out / "explanation.json").read_text()) == fields
    assert sorted(fields["files"]) == sorted(map(str, out.iterdir()))
    sentence = fields["phases"][0]["sentence"]
    assert sentence in (out / "explanation.html").read_text()
    assert sentence in said.err
    # A recording of the same drive is explained in the same way.
    write_drive(tmp_path / "run.mcap", course=SHORT)
    recorded = json.loads(explain(str(tmp_path / "run.mcap")).result().model_dump_json())
    sentences = [[phase["sentence"] for phase in each["phases"]] for each in (recorded, fields)]
    assert sentences[0] == sentences[1]
    for name in ("contributions", "time_constants", "knock_outs", "sensitivities"):
        assert recorded[name] == fields[name]


def test_what_is_no_drive_of_one_course_is_not_explained(tmp_path, capsys):
    path = tmp_path / "run.mcap"
    write_drive(path, course=SHORT, place={"name": "bay"})
    assert run(["explain", str(path)]) == 2
    assert f"'rover-ncp report {path}' explains it" in capsys.readouterr().err
    assert run(["explain", str(path), "--course", "bay"]) == 2
    assert "--course bay: does not go with a recording" in capsys.readouterr().err
