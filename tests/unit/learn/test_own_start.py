"""Training that starts from a policy file: its neurons, sensing and motors are the user's."""

import numpy as np
from kit.paths import DATA, ROOT

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.course.course import load_course
from sim.learn.ensemble import train
from sim.learn.robust import policy_box, train_robust
from sim.learn.rollout import rollout
from sim.learn.settings import RobustSettings

SHORT = str(DATA / "short_course.yaml")
FORWARD = ROOT / "docs" / "examples" / "policy.yaml"


def test_training_keeps_sensing_and_motors_and_moves_parameters(tmp_path):
    start = load_policy(FORWARD)
    settings = {"course": SHORT, "circuit": str(FORWARD), "agents": 1, "iterations": 30}
    trained = load_policy(train(settings, tmp_path / "run", processes=1).policy_path)
    assert (trained.sensing, trained.motors) == (start.sensing, start.motors)
    assert trained.circuit.neurons == start.circuit.neurons
    assert trained.parameters().tolist() != start.parameters().tolist()
    assert trained.courses == ("short",)
    course = load_course(SHORT)
    assert rollout(trained, course).total > rollout(start, course).total


def test_robust_training_goes_on_from_a_shipped_policy_in_small_steps(tmp_path):
    settings = {"course": SHORT, "iterations": 1, "rollouts": 2, "random_courses": 0, "circuit": "course"}
    start, moved = load_policy("course"), []
    for refine in (True, False):
        asked = RobustSettings(**settings, refine=refine)
        path, _ = train_robust(asked, tmp_path / f"{refine}", processes=1)
        found = load_policy(path)
        assert found.sensing == start.sensing
        assert ("--refine" in found.provenance["command"].split()) == refine
        moved.append(np.linalg.norm(policy_box(found).start - policy_box(start).start))
    assert 0.0 < moved[0] < 0.5 * moved[1]
