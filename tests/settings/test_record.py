"""What is known of a setting is found again beside its value."""

import dataclasses

import jax
import pytest

from remind_jax.settings.record import Setting, setting, walk_settings


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Inner:
    a: float = setting(0.5, "how much", "share", more="more of it", symbol="α", key="x.a")
    b: tuple[int, int] = setting((1, 2), "two of them", key=("x.low", "x.low"))


@dataclasses.dataclass(frozen=True)
class Outer:
    inner: Inner = dataclasses.field(default_factory=Inner)
    own: int = 3


def test_records_come_with_key_and_value():
    found = {key: (value, record) for key, value, record in walk_settings(Outer(), "top.")}
    assert found == {
        "top.inner.a": (0.5, Setting("how much", "share", "more of it", "α", "x.a")),
        "top.inner.b": ((1, 2), Setting("two of them", key=("x.low", "x.low"))),
        "top.own": (3, Setting("")),
    }


@pytest.mark.parametrize(
    ("record", "keys"),
    [
        (Setting(""), ()),
        (Setting("", key="x.a"), ("x.a",)),
        (Setting("", key=("x.low", "x.high")), ("x.low", "x.high")),
        (Setting("", key=("x.low", "x.low")), ("x.low",)),
        (Setting("", decided_by=("x.c", "x.d")), ()),
    ],
)
def test_keys_that_decide_alone(record, keys):
    assert record.own_keys == keys


def test_a_record_changes_nothing_of_its_dataclass():
    assert dataclasses.asdict(Inner()) == {"a": 0.5, "b": (1, 2)}
    assert Inner() == Inner(0.5)
    assert hash(Inner()) == hash(Inner(0.5))
    assert jax.tree.leaves(Inner(b=(4, 5))) == [0.5, 4, 5]
