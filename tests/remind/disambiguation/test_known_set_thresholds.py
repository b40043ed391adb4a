import dataclasses

from remind_jax.remind.thresholds.known_sets import FIXED, INERT, RENAMED, KnownSets
from remind_jax.static import Static


def test_every_threshold_has_one_key_of_the_original():
    paths = list(RENAMED.values())
    assert len(set(paths)) == len(paths)
    prefix = "thresholds.known_sets."
    named = {path.removeprefix(prefix) for path in paths if path.startswith(prefix)}
    assert named == {field.name for field in dataclasses.fields(KnownSets)}
    static = {path.removeprefix("static.") for path in paths if path.startswith("static.")}
    assert static <= {field.name for field in dataclasses.fields(Static)}
    assert not set(RENAMED) & (set(INERT) | set(FIXED))
