"""`--set KEY=VALUE`: single values of a configuration, changed on the command line."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import UseAppendAction, arg

from remind_jax.errors import ConfigError

if TYPE_CHECKING:
    from remind_jax.config import Config

_MOST_CHARACTERS = 10_000  # of one value

# Both `--set a=1 b=2` and `--set a=1 --set b=2`.
Assignments = Annotated[
    UseAppendAction[tuple[tuple[str, ...], ...]],
    arg(
        name="set",
        metavar="KEY=VALUE ...",
        help="change single values of the configuration (see 'remind config show')",
    ),
]


def load_config_with(
    name: str, assignments: Assignments = (), tracker: str | None = None
) -> Config:
    """A configuration by name or file, with single values changed.

    Args:
      name: Name of a shipped configuration, or a YAML file.
      assignments: Changes as `dotted.key=value`, values in YAML.
      tracker: Name of the method that the changes are for; that of the configuration if left out.

    Raises:
      ConfigError: If the configuration, the tracker or a key is unknown, or a value of the wrong
        kind.
    """
    from remind_jax.config import load_config

    changes = parse_assignments(itertools.chain(*assignments))
    config = load_config(name)
    if tracker is not None:
        config = config.with_tracker(tracker)
    return config.updated(changes, "--set")


def parse_assignments(assignments: Iterable[str]) -> dict[str, Any]:
    """Turns `["a.b=1", "c=x"]` into `{"a.b": 1, "c": "x"}`; of one key the last counts.

    Raises:
      ConfigError: If a text is no assignment.
    """
    from remind_jax.files.yaml_text import parse_yaml  # help answers without it

    values: dict[str, Any] = {}
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals or not key or "" in key.split("."):
            raise ConfigError(
                f"{assignment!r} is no assignment; give --set KEY=VALUE, for example "
                "--set thresholds.decision.new=1.5, after everything else"
            )
        if len(text) > _MOST_CHARACTERS:
            raise ConfigError(
                f"the value of --set {key} has {len(text)} characters; at most {_MOST_CHARACTERS} "
                "are read, so put it into a file"
            )
        values[key] = parse_yaml(text, f"the value of --set {assignment!r}", ConfigError)
    return values
