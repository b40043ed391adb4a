"""A tracker goes on only from a memory that suits it."""

import dataclasses
import operator
import re

import pytest

from remind_jax.config import load_config
from remind_jax.errors import RemindError
from remind_jax.remind.state import init
from remind_jax.session.memory_file import SavedMemory, load_memory, save_memory
from remind_jax.session.memory_fit import check_backbone, check_tracker, static_of
from tests.statics import change_static
from tests.tiny_world import STATIC


@pytest.fixture
def memory() -> SavedMemory:
    return SavedMemory(init(STATIC), STATIC, ("cup",), "patch-statistics")


def test_features_of_another_backbone_are_refused(memory, tmp_path):
    for known, now in (("", ""), ("a", ""), ("", "a"), ("a", "a")):
        made = dataclasses.replace(memory, fingerprint=known)
        check_backbone(made, "patch-statistics", now, "file")
    with pytest.raises(RemindError, match="cannot be compared"):
        check_backbone(memory, "dinov3", "", "file")
    save_memory(tmp_path / "memory", made)
    assert load_memory(tmp_path / "memory").fingerprint == "a"
    with pytest.raises(RemindError, match="other weights or options"):
        check_backbone(made, "patch-statistics", "b", "file")


def test_switches_that_leave_room_are_followed(memory):
    config = load_config({"base": "remind", "static": {"assignment": "greedy", "num_objects": 999}})
    going_on = static_of(memory, config, "file")
    assert going_on == change_static(STATIC, assignment="greedy")
    assert static_of(memory, load_config("published"), "file") == STATIC


@pytest.mark.parametrize(
    ("name", "value"),
    [("switches.appearance_slots", (3, 5)), ("precision", "float64"), ("first_object_id", 100)],
)
def test_switches_that_ask_for_another_memory_are_refused(memory, name, value):
    config = load_config({"base": "remind", f"static.{name}": value})
    made_with = re.escape(str(operator.attrgetter(name)(STATIC)))
    with pytest.raises(RemindError, match=rf"file was made with static\.{name} {made_with}, not"):
        static_of(memory, config, "file")
    assert static_of(memory, load_config("remind"), "file") == STATIC


@pytest.mark.parametrize(("tracker", "said"), [("plus", "--config"), ("bank", "--tracker")])
def test_the_memory_of_another_tracker_says_what_to_do(memory, tracker, said):
    made = dataclasses.replace(memory, tracker=tracker)
    with pytest.raises(RemindError, match=rf"memory of tracker '{tracker}'.*{said} {tracker}, or"):
        check_tracker(made, "remind", "file")
    check_tracker(made, tracker, "file")
