"""The judge of a docking alone: what counts as docked, as a miss, and as not known yet."""

import pytest
from kit.virtual_docking import place

from deploy.place.judge import approached, judge_approach, judge_report
from deploy.place.outcome import DockError, Evidence
from rover_ncp.course.scoring import Verdict

GOAL, SURE = place().goal, Verdict(True, 0.0, 0.0, probability=0.99)
BESIDE, OTHER_DOCK = GOAL._replace(y=GOAL.y + 0.03), GOAL._replace(y=GOAL.y + 0.2)


@pytest.mark.parametrize(
    ("proof", "contact", "pose", "poses", "words"),
    [
        ("pose", False, GOAL, [GOAL] * 3, ""),
        ("pose", False, GOAL, [BESIDE] * 3, "by the external poses alone"),
        ("pose", False, GOAL, [BESIDE] * 2, ""),
        ("pose", True, GOAL, [GOAL] * 3, "contact"),
        ("charging", True, GOAL, [], None),
        ("charging", True, OTHER_DOCK, [], "contact"),
        ("topic", False, OTHER_DOCK, [], "too far for the place's dock"),
    ],
)
def test_approach_is_docked_a_miss_or_to_be_proved(proof, contact, pose, poses, words):
    where = place(proof=proof)
    end = approached(where, pose, SURE.probability, poses)
    found = judge_approach(where, pose, SURE, end, contact)
    if words is None:
        assert found is None
    else:
        assert words in found.why
        assert (found.error is DockError.NONE) == (found.why == words == "")


@pytest.mark.parametrize("docked", [True, False, None])
def test_only_a_report_after_the_approach_proves_a_docking(docked):
    def judged(reports, t):
        return judge_report(place(proof="charging").proof, Evidence(False, docked, reports), 5, t, 100.0)

    assert judged(5, 124.9) is None
    assert judged(5, 200.0).error is DockError.FAILED_TO_CHARGE
    assert (judged(6, 101.0) is not None) == (docked is True)
    assert judged(5, 200.0).gives_up == (docked is None)
