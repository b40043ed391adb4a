"""How flags are read and described: in the words of the shell, not of Python or the parser."""

from __future__ import annotations

import dataclasses
import itertools
import reprlib
import types
from collections.abc import Iterable
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    TypeVar,
    Union,
    dataclass_transform,
    get_args,
    get_type_hints,
)

from tyro.conf import Positional, UseAppendAction, arg
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    UnsupportedTypeAnnotationError,
)

from remind_jax.backbone.vit_variants import VARIANTS
from remind_jax.detectors.options import DetectorOptions
from remind_jax.errors import ConfigError, OptionError
from remind_jax.files import check_name
from remind_jax.printing.words import listing
from remind_jax.settings.method_names import find_methods
from remind_jax.sources.live_source import LiveOptions
from remind_jax.sources.sampling import Sampling

VerbT = TypeVar("VerbT")
KINDS = ConstructorRegistry()  # how values of each kind are read and called

BackboneName = Annotated[
    str,
    arg(
        metavar="NAME",
        help="what patch features come from: patch-statistics, which needs no weights; a network, "
        f"whose weights are fetched on first use (see 'remind backbones'): {', '.join(VARIANTS)}; "
        "vit for whatever --weights holds; onnx:FILE, any ONNX encoder",
    ),
]

TrackerName = Annotated[
    str | None,
    arg(
        metavar="NAME",
        help=f"{listing(list(find_methods()), 'or')}, with the thresholds of the configuration of "
        "that name, else its published ones; that of the configuration if left out",
    ),
]

# What is one word, by its type: how help calls it, and how messages do.
_WORDS: dict[Any, tuple[str, str]] = {
    int: ("N", "whole number"),
    float: ("X", "number"),
    str: ("NAME", "text"),
    Path: ("PATH", "path"),
}
_NOTHING = ("None", "False", "")  # defaults that the help of a flag says in words, if at all

_MAX_CHARACTERS = 10_000  # of one value
# Both `--set a=1 b=2` and `--set a=1 --set b=2`.
Assignments = Annotated[
    UseAppendAction[tuple[tuple[str, ...], ...]],
    arg(
        name="set",
        metavar="KEY=VALUE ...",
        help="change single values of the configuration (see 'remind config show')",
    ),
]


class UsageError(Exception):
    """Flags whose values make no sense, in one sentence.

    No `ValueError`: the parser catches those and reports them with its own inner names.
    """


def spell_flag(option: str) -> str:
    """The flag that sets an option: `max_frames` is `--max-frames`."""
    return "--" + option.replace("_", "-")


class _Checked:
    """Brings errors of options past the parser to the user, with flags in the place of names."""

    def __post_init__(self) -> None:
        try:
            super().__post_init__()  # pyright: ignore[reportAttributeAccessIssue]
        except OptionError as error:
            raise UsageError(error.spelled(spell_flag)) from error


def _show_default(default: str) -> str:
    return "" if default in _NOTHING else f"(default: {default})"


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def flags(given: type[VerbT]) -> type[VerbT]:
    """A frozen dataclass of flags, whose help leaves out defaults that say nothing."""
    made = dataclasses.dataclass(frozen=True)(given)
    for name, kind in get_type_hints(made, include_extras=True).items():
        made.__annotations__[name] = Annotated[kind, arg(help_behavior_hint=_show_default)]
    return made


@flags
class SamplingFlags(_Checked, Sampling):
    """Frames are chosen by number (--start, --end) first, then by --stride or --fps."""


@flags
class DetectionFlags(_Checked, DetectorOptions):
    """Thresholds and class lists of the detector."""

    def check_used_by(self, detector: Path | None) -> None:
        """Refuses flags that would change nothing.

        Raises:
          UsageError: If there is no detector, and one of them has another value than its default.
        """
        for field in dataclasses.fields(self):
            if detector is None and getattr(self, field.name) != field.default:
                raise UsageError(
                    f"{spell_flag(field.name)} is for a detector; give --detector, or leave it out"
                )


class PageAddress:
    """Where a page is shown: HOST:PORT, or True where nothing was said."""

    def __init__(self, where: bool | str) -> None:
        self.where = where


@flags
class LiveFlags(_Checked, LiveOptions):
    """Cameras (0, /dev/video0) and streams (rtsp://, http://)."""

    # folder that gets the frames as seen, to repeat the run
    record: Path | None = None
    # show the run in a browser while it goes on; only to this machine unless HOST:PORT says
    # otherwise; stands after SOURCE
    live: Annotated[PageAddress | None, arg(metavar="[HOST:PORT]")] = None
    no_browser: bool = False  # open no browser, only say where the page is

    def as_options(self) -> dict[str, Any]:
        """What `open_source` takes of them."""
        names = [field.name for field in dataclasses.fields(LiveOptions)]
        return {name: getattr(self, name) for name in names}


@KINDS.primitive_rule
def _read_page_address(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    if info.type is not PageAddress:
        return None

    def read(words: list[str]) -> PageAddress:
        if len(words) > 1:
            raise ValueError(f"{words[1]!r} follows it; put SOURCE before it")
        return PageAddress(words[0] if words else True)

    return PrimitiveConstructorSpec(
        nargs="*",
        metavar="[HOST:PORT]",
        instance_from_str=read,
        is_instance=lambda value: isinstance(value, PageAddress),
        str_from_instance=lambda value: [str(value.where)],
    )


@KINDS.primitive_rule
def _read_word(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    if info.type not in _WORDS:
        return None
    metavar, kind = _WORDS[info.type]

    def read(words: list[str]) -> Any:
        if info.type is Path and (wrong := check_name(words[0])):
            raise UsageError(f"the path {words[0][:40]!r} cannot be used: {wrong}")
        try:
            # Python also reads 1_000, and digits of other scripts.
            is_plain = words[0].isascii() and "_" not in words[0] and words[0] == words[0].strip()
            if info.type in (int, float) and not is_plain:
                raise ValueError
            return info.type(words[0])
        except ValueError:
            raise ValueError(f"{reprlib.repr(words[0])} is no {kind}; give one") from None

    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=read,
        is_instance=lambda value: isinstance(value, info.type),
        str_from_instance=lambda value: [f"{value:g}" if info.type is float else str(value)],
    )


@KINDS.primitive_rule
def _read_names(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    if info.type != tuple[str, ...]:
        return None

    def read(words: list[str]) -> tuple[str, ...]:
        if not words and Positional not in info.markers:
            raise ValueError("nothing follows it; give at least one, or leave it out")
        return tuple(words)

    return PrimitiveConstructorSpec(
        nargs="*",
        metavar="NAME ...",
        instance_from_str=read,
        is_instance=lambda value: isinstance(value, tuple),
        str_from_instance=list,
    )


@KINDS.primitive_rule
def _read_what_may_be_left_out(
    info: PrimitiveTypeInfo,
) -> PrimitiveConstructorSpec[Any] | UnsupportedTypeAnnotationError | None:
    """`X | None` is read as X: None is what a flag is that was left out, never a word."""
    kinds = [kind for kind in get_args(info.type) if kind is not type(None)]
    if info.type_origin not in (Union, types.UnionType) or len(kinds) != 1:
        return None
    inner = PrimitiveTypeInfo.make(kinds[0], info.markers)
    spec = ConstructorRegistry.get_primitive_spec(inner)
    if isinstance(spec, UnsupportedTypeAnnotationError):
        return spec
    show = spec.str_from_instance
    return dataclasses.replace(
        spec,
        is_instance=lambda value: value is None or spec.is_instance(value),
        str_from_instance=lambda value: ["None"] if value is None else show(value),
    )


if TYPE_CHECKING:
    from remind_jax.config import Config


def load_config_with(
    name: str, assignments: Assignments = (), tracker: str | None = None
) -> Config:
    """A configuration by name or file, with single values changed.

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
        if len(text) > _MAX_CHARACTERS:
            raise ConfigError(
                f"the value of --set {key} has {len(text)} characters; at most {_MAX_CHARACTERS} "
                "are read, so put it into a file"
            )
        values[key] = parse_yaml(text, f"the value of --set {assignment!r}", ConfigError)
    return values
