"""YAML as plain nested values: no objects, no key twice, refused in one sentence."""

from __future__ import annotations

import collections
import re
from collections.abc import Callable, Hashable
from typing import Any

import yaml

from remind_jax.errors import RemindError

_PLAIN = re.compile(
    r"[-+]?(0|[1-9][0-9]*|[0-9]*\.[0-9]*|[0-9.]+[eE][-+]?[0-9]+|\.(inf|Inf|INF))|\.(nan|NaN|NAN)"
)


class _Loader(yaml.SafeLoader):
    """Loads plain values; the parser in C ends the process on deep nesting."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Refuses a key that stands twice."""
        keys = collections.Counter(
            key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)
        )
        twice = next((key for key, count in keys.items() if count > 1 and key != "<<"), None)
        if twice is not None:
            raise yaml.constructor.ConstructorError(
                None, None, f"the key {twice!r} stands twice", node.start_mark
            )
        return super().construct_mapping(node, deep)


def _decimal(construct: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """Numbers as people write them: YAML would take 010 for 8, 1:30 for 90 and 1_000 for 1000."""

    def checked(loader: _Loader, node: yaml.ScalarNode) -> Any:
        if not _PLAIN.fullmatch(node.value):
            said = f"the number {node.value!r} is not written in decimal, as 10 or 2.5 are"
            raise yaml.constructor.ConstructorError(None, None, said, node.start_mark)
        return construct(loader, node)

    return checked


for _kind, _construct in (
    ("int", yaml.SafeLoader.construct_yaml_int),
    ("float", yaml.SafeLoader.construct_yaml_float),
):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _decimal(_construct))


# YAML 1.1 takes 1e-3 for a text.
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$"),
    list("-+.0123456789"),
)


def parse_yaml(text: str, where: str, refused: type[RemindError]) -> Any:
    """Values of one document.

    Raises:
      RemindError: Of kind `refused`, if it is no YAML, or nested too deep.
    """
    try:
        return yaml.load(text, _Loader)  # derived from the safe loader
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f", line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        raise refused(f"{where}{place} is not valid YAML: {error.problem}; correct it") from error
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        said = " ".join(str(error).split())
        raise refused(f"{where} is not valid YAML: {said}; correct it") from error
    except RecursionError as error:
        raise refused(f"{where} is not valid YAML: it is nested too deep; correct it") from error
