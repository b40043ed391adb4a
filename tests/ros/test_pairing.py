import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.errors import OptionError, SourceError
from remind_ros.pairing import Pairing, slop_in_ns


def test_an_image_waits_for_its_detections():
    pairing = Pairing(("image", "boxes"), slop_ns=5)
    assert pairing.add("image", 100, "i1") == []
    assert pairing.add("image", 200, "i2") == []
    assert pairing.add("boxes", 203, "b2") == [{"image": "i2", "boxes": "b2"}]
    assert pairing.add("boxes", 101, "b1") == []  # its image was let go


def test_detections_may_come_first():
    pairing = Pairing(("image", "boxes", "map"), slop_ns=0)
    assert pairing.add("boxes", 7, "b") == []
    assert pairing.add("map", 7, "m") == []
    assert pairing.add("image", 7, "i") == [{"image": "i", "boxes": "b", "map": "m"}]


def test_the_nearest_stamp_wins():
    pairing = Pairing(("image", "boxes"), slop_ns=10)
    pairing.add("boxes", 95, "far")
    pairing.add("boxes", 99, "near")
    assert pairing.add("image", 100, "i") == [{"image": "i", "boxes": "near"}]


def test_an_image_alone_is_complete():
    assert Pairing(("image",), 0).add("image", 3, "i") == [{"image": "i"}]


@given(st.permutations([(topic, time) for topic in ("image", "boxes") for time in range(1, 7)]))
def test_sets_come_in_order_and_once(order):
    pairing = Pairing(("image", "boxes"), slop_ns=0)
    sets = [found for topic, time in order for found in pairing.add(topic, time, time)]
    times = [one["image"] for one in sets]
    assert times == sorted(set(times))
    assert all(one["boxes"] == one["image"] for one in sets)
    assert times  # the last of both is always there


def test_no_more_wait_than_allowed():
    pairing = Pairing(("image", "boxes"), slop_ns=0, most=3)
    for time in range(1, 11):
        pairing.add("image", time, time)
    assert pairing.add("boxes", 7, 7) == []
    assert pairing.add("boxes", 8, 8) == [{"image": 8, "boxes": 8}]


def test_time_may_start_again():
    pairing = Pairing(("image",), slop_ns=0)
    assert pairing.add("image", 9_000_000_000, "late")
    assert pairing.add("image", 8_000_000_000, "too late") == []
    assert pairing.add("image", 7_900_000_000, "again") == [{"image": "again"}]
    assert pairing.add("image", 8_000_000_000, "next") == [{"image": "next"}]


def test_what_waits_in_vain_is_let_go_where_time_starts_again():
    pairing = Pairing(("image", "boxes"), slop_ns=0, most=3)
    for time in range(3):
        pairing.add("image", 9_000_000_000 + time, "nobody detects")
    pairing.add("image", 1_000_000_000, "again")
    assert pairing.add("boxes", 1_000_000_000, "b") == [{"image": "again", "boxes": "b"}]


def test_a_message_needs_a_stamp():
    with pytest.raises(SourceError, match="the stamp 0 ns"):
        Pairing(("image",), 0).add("image", 0, "i")


def test_what_goes_unanswered_is_noticed():
    pairing = Pairing(("image", "boxes"), slop_ns=0, most=3)
    noticed = []
    for time in range(1, 6):
        pairing.add("image", time, time)
        noticed.append(pairing.is_full)
    assert noticed == [False, False, False, True, True]
    pairing.add("boxes", 5, 5)
    pairing.add("image", 6, 6)
    assert not pairing.is_full


@pytest.mark.parametrize("seconds", [-0.01, np.nan, np.inf])
def test_a_slop_is_a_time(seconds):
    with pytest.raises(OptionError, match="slop_s"):
        slop_in_ns(seconds)
