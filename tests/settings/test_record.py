"""What is known of a setting is found again beside its value."""

import dataclasses

from remind_jax.settings.record import Setting, setting, walk_settings


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
    assert [record.own_keys for _, record in found.values()] == [("x.a",), ("x.low",), ()]
