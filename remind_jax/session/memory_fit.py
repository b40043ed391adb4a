"""Whether a memory that was read suits the tracker that is to go on from it."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from remind_jax.config import Config
from remind_jax.config.dotted_keys import flatten_fields
from remind_jax.config.keys import how_to_choose
from remind_jax.errors import RemindError
from remind_jax.session.memory_file import SavedMemory, shape_of
from remind_jax.session.preparation import ANY_CLASS
from remind_jax.static import Static

_GROWN = ("num_detections", "num_objects", "num_pending", "feature_dim")  # follow the frames
_BOUND = ("first_object_id", "precision")  # a memory has them from its start


def check_tracker(memory: SavedMemory, tracker: str, path: str | Path) -> None:
    """Refuses the memory of another tracker. Raises RemindError if the trackers differ."""
    if memory.tracker != tracker:
        raise RemindError(
            f"{path} is the memory of tracker '{memory.tracker}', not '{tracker}'; go on with "
            f"{how_to_choose(memory.tracker)}"
        )


def check_backbone(memory: SavedMemory, backbone: str, fingerprint: str, path: str | Path) -> None:
    """Refuses features that the memory was not made with.

    Raises:
      RemindError: If the backbones differ.
    """
    if memory.backbone == backbone:
        if len({memory.fingerprint, fingerprint} - {""}) < 2:
            return
        raise RemindError(
            f"{path} was made with other weights or options of backbone '{backbone}'; their "
            "features cannot be compared"
        )
    raise RemindError(
        f"{path} was made with backbone '{memory.backbone}', not '{backbone}'; features of "
        "different backbones, or of frames and closeups (input.closeups), cannot be compared"
    )


def check_classes(
    memory: SavedMemory, is_agnostic: bool, path: str | Path, advice: str = ""
) -> None:
    """Refuses a memory of classes where none are told apart, and the other way around.

    Args:
      memory: One that is loaded or joined.
      is_agnostic: Whether no classes are told apart.
      path: Its file.
      advice: What to do, where it is not for a setting to change that.

    Raises:
      RemindError: If its objects would not be recognized for that.
    """
    has_classes = any(name != ANY_CLASS for name in memory.class_names)
    if has_classes if is_agnostic else was_made_without_classes(memory):
        made, hint = ("with", "leave out") if has_classes else ("without", "set")
        advice = advice or f"{hint} input.class_agnostic, or start without the memory"
        raise RemindError(f"{path} was made {made} classes; {advice}")


def was_made_without_classes(memory: SavedMemory) -> bool:
    """Whether its objects are of one class because classes were not compared.

    Where every object was called by the name of that class, it makes no difference.
    """
    return {*memory.class_names} == {ANY_CLASS} and bool(memory.records.labels - {ANY_CLASS})


def static_of(memory: SavedMemory, config: Config, path: str | Path) -> Static:
    """Capacities and structural switches to go on with: those of the memory.

    Switches that a configuration chose take their place where the memory has room for them.

    Raises:
      RemindError: If one of them asks for a memory of another shape.
    """
    static, made_with = memory.static, dict(flatten_fields(memory.static))
    for key, value in _chosen_switches(config).items():
        other = _with_switch(memory.static, key, value)
        is_bound = key in _BOUND and value != made_with[key]
        if is_bound or shape_of(memory.tracker, other) != shape_of(memory.tracker, memory.static):
            raise RemindError(
                f"{path} was made with static.{key} {made_with[key]}, not {value}; leave that as "
                "it was, or start without the memory"
            )
        static = _with_switch(static, key, value)
    return static


def _chosen_switches(config: Config) -> dict[str, Any]:
    """What a configuration chose of `static` beside capacities that follow the frames, by key."""
    switches = type(config.static.switches)()
    published = dict(flatten_fields(Static(switches=switches)))
    return {
        key: value
        for key, value in flatten_fields(config.static)
        if key not in _GROWN and (f"static.{key}" in config.chosen or value != published[key])
    }


def _with_switch(static: Static, key: str, value: Any) -> Static:
    """The same with another value of one key, dotted."""
    section, _, name = key.rpartition(".")
    if not section:
        return dataclasses.replace(static, **{name: value})
    switches = dataclasses.replace(static.switches, **{name: value})
    return dataclasses.replace(static, switches=switches)
