"""What ``up`` says and does after a break of the line, and how often it starts a process again."""

import pytest

from deploy.up.advice import MAX_RESUMES, NOTICE_S, Begin, LineBreaks
from deploy.up.restarts import MAX_WAIT_S, Restarts

CONNECTED = "the base is connected: Pioneer"
DOCKS, RELEASED = "docking at home got the lease", "docking at home released the lease"
LATE, LOST = "stopped: odometry", "the base is lost: no base report for 0.5 s"
REVOKED = "docking at home lost the lease: no-base, the base is not connected"
BACK = "the base sends packets again"
PRESSED = "hazard: stop-button"
STOP = "the peer with the Zenoh id f00d requests a stop: rover-ncp stop"


def follow(breaks, lines, now_s=0.0, step_s=0.1):
    """Give lines to breaks, one after the other; return the last advice and the time."""
    advice = ""
    for line in lines:
        advice, now_s = breaks.take(line, now_s), now_s + step_s
    return advice, now_s


def made(**how):
    breaks = LineBreaks(**{"fenced": False, "resume": True} | how)
    breaks.take(CONNECTED, 0.0)
    return breaks


@pytest.mark.parametrize("broken", [[LATE, RELEASED, LOST], [LOST, REVOKED], [REVOKED, LOST]])
def test_a_docking_that_a_lost_line_ended_resumes_after_its_notice(broken):
    breaks = made()
    advice, now_s = follow(breaks, [DOCKS, *broken, BACK])
    assert "resumes in 5 s (1 of 3)" in advice
    assert breaks.due(now_s + NOTICE_S - 0.5) is None
    assert breaks.due(now_s + NOTICE_S) == Begin("home", 1)
    assert breaks.due(now_s + NOTICE_S + 1.0) is None


@pytest.mark.parametrize(
    "lines",
    [
        [DOCKS, RELEASED, LOST, BACK],  # it had ended before
        [DOCKS, LATE, RELEASED, STOP, LOST, BACK],
        [DOCKS, LATE, RELEASED, LOST, BACK, STOP],
        [DOCKS, LATE, RELEASED, LOST, BACK, PRESSED],
        [DOCKS, REVOKED, LOST, PRESSED, BACK],
        [DOCKS, LATE, RELEASED, LOST, BACK, LOST],
        [DOCKS, "stopped: bumper", "docking at home lost the lease: bumper, ", LOST, BACK],
        [DOCKS, LATE, RELEASED, LOST, CONNECTED],  # odometry restarted
        ["policy course got the lease", LATE, "policy course released the lease", LOST, BACK],
        ["undocking from home got the lease", LOST, "undocking from home lost the lease: no-base, x", BACK],
    ],
)
def test_nothing_resumes_after_anything_else(lines):
    breaks = made()
    _, now_s = follow(breaks, lines)
    assert breaks.due(now_s + 2 * NOTICE_S) is None


@pytest.mark.parametrize(
    ("line", "recalled"),
    [
        *((line, True) for line in (PRESSED, STOP, CONNECTED, "teleop got the lease")),
        ("docking at bay got the lease", True),
        (DOCKS, False),
    ],
)
def test_a_docking_that_has_not_driven_yet_is_recalled_by_what_would_have_prevented_it(line, recalled):
    breaks = made()
    _, now_s = follow(breaks, [DOCKS, LATE, RELEASED, LOST, BACK])
    assert breaks.due(now_s + NOTICE_S)
    assert not breaks.recall()
    breaks.take(line, now_s + NOTICE_S + 1.0)
    assert [breaks.recall(), breaks.recall()] == [recalled, False]
    breaks.ended()
    breaks.take(PRESSED, now_s + NOTICE_S + 2.0)
    assert not breaks.recall()


def test_a_resume_that_a_hazard_cancels_is_named():
    breaks = made()
    _, now_s = follow(breaks, [DOCKS, LATE, RELEASED, LOST, BACK])
    assert breaks.take(PRESSED, now_s) == "the docking at home does not resume"
    assert breaks.take(PRESSED, now_s + 0.1) == ""


def test_nothing_resumes_unless_the_file_says_so():
    breaks = made(resume=False)
    advice, now_s = follow(breaks, [DOCKS, LATE, RELEASED, LOST, BACK])
    assert advice == "start the docking again: rover-ncp deploy --to home"
    assert breaks.due(now_s + 2 * NOTICE_S) is None


def test_a_docking_resumes_three_times_at_most_unless_a_person_begins_it():
    breaks, now_s = made(), 0.0
    for _ in range(2):
        for number in range(MAX_RESUMES):
            _, now_s = follow(breaks, [DOCKS, DOCKS, LATE, RELEASED, LOST], now_s)
            breaks.ended()
            breaks.take(BACK, now_s)
            now_s += NOTICE_S
            assert breaks.due(now_s) == Begin("home", number + 1)
        advice, now_s = follow(breaks, [DOCKS, LATE, RELEASED, LOST, BACK], now_s)
        assert "has resumed 3 times" in advice
        assert breaks.due(now_s + 2 * NOTICE_S) is None
        breaks.ended()


def test_odometry_that_restarted_behind_a_fence_says_where_to_put_the_rover():
    breaks = made(fenced=True)
    assert "where the fence begins" in follow(breaks, [LOST, CONNECTED])[0]


def test_restarts_are_spaced_and_a_steady_process_starts_soon_again():
    restarts, now_s, waits = Restarts(), 0.0, []
    for _ in range(8):
        waits.append(restarts.ended(now_s + 1.0, now_s))
        now_s += 1.0 + waits[-1]
    assert waits[:3] == [1.0, 2.0, 4.0]
    assert waits[-1] == MAX_WAIT_S
    assert restarts.ended(now_s + 600.0, now_s) == 1.0
