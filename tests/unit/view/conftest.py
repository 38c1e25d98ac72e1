"""A short drive of the policy parking, and the live page of it."""

from types import SimpleNamespace

import pytest
from kit.recorded_drives import drive_messages

from deploy.view.feed import Feed
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.course.course import load_course


@pytest.fixture(scope="session")
def short():
    policy, course = load_policy("parking"), load_course("tests/data/short_course.yaml")
    messages, run = drive_messages(policy, course)
    return SimpleNamespace(policy=policy, course=course, messages=messages, run=run)


@pytest.fixture
def feed(short):
    return Feed(short.policy, short.course)
