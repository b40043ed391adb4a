"""YAML as plain nested values: no objects, no key twice, refused in one sentence."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

import yaml

from remind_jax.errors import RemindError


class _Loader(yaml.SafeLoader):
    """Loads plain values; the parser in C ends the process on deep nesting."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Refuses a key that stands twice."""
        keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        twice = next((key for place, key in enumerate(keys) if key in keys[:place]), None)
        if twice is not None and twice != "<<":
            raise yaml.constructor.ConstructorError(
                None, None, f"the key {twice!r} stands twice", node.start_mark
            )
        return super().construct_mapping(node, deep)


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
    except (yaml.YAMLError, ValueError) as error:
        said = " ".join(str(error).split())
        raise refused(f"{where} is not valid YAML: {said}; correct it") from error
    except RecursionError as error:
        raise refused(f"{where} is not valid YAML: it is nested too deep; correct it") from error
