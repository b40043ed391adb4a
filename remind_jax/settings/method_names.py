"""The trackers of this package by name, found without importing any."""

from __future__ import annotations

from pathlib import Path

PAPER_METHOD = "remind"  # the published one; that of a `Config()` that names none


def find_methods() -> dict[str, str]:
    """Where each is, as `module:attribute`; that of the configuration `default` first.

    Every module of `remind_jax/baselines/` is a baseline that is called as its file.
    """
    files = (Path(__file__).parents[1] / "baselines").glob("*.py")
    modules = sorted(file.stem for file in files if file.stem != "__init__")
    return {
        "plus": "remind_jax.plus.method:METHOD",
        PAPER_METHOD: "remind_jax.remind.method:METHOD",
        **{one.replace("_", "-"): f"remind_jax.baselines.{one}:METHOD" for one in modules},
    }
