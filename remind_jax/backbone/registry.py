"""Backbones by name, found without importing any of them.

Letters: `B` images, `H W` their size in pixels, `Hp Wp` the patch grid, `D` feature dimension.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import inspect
import re
from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from remind_jax.backbone.vit_variants import VARIANTS
from remind_jax.errors import ConfigError, OptionError, SourceError, nearest_names
from remind_jax.settings.ranges import check_option

if TYPE_CHECKING:
    import jax
    import numpy as np
    from jaxtyping import Bool, Float, Int, UInt8

    from remind_jax.backbone.vit_attention import ObjectAttention

DEFAULT_BACKBONE = "patch-statistics"

_MAX_NUMBERS = 1 << 16  # pixels of a patch, and numbers that describe one


@dataclasses.dataclass(frozen=True)
class Backbone:
    """A frozen feature extractor; make one with `get_backbone`.

    `apply` maps uint8 RGB `[B, H, W, 3]` to float32 `[B, Hp, Wp, D]` and compiles once per image
    size; call `extract`, which checks the images first. Backbones with attention also map images
    and patch numbers `[B, K]` to these features and `vit_attention.ObjectAttention`.
    """

    name: str
    patch_px: int
    dim: int
    apply: Callable[[Any], Any]
    apply_with_attention: Callable[..., Any] | None = None
    fingerprint: str = ""  # changes whenever features may: weights, precision, options
    # From images and wanted patches `[B, Hp, Wp]`, bool, to the same features of these, and zeros
    # for all others; left out, all patches are always described.
    apply_to: Callable[[Any, Any], Any] | None = None
    # From pictures of single detections, wanted patches, and the share of each that the detection
    # covers, `[B, Hp, Wp]`, to features of what it looks like, and beside these, in the last
    # `num_background` channels, of its background. Left out, such pictures are read as frames are.
    apply_closeups: Callable[[Any, Any, Any], Any] | None = None
    num_background: int = 0
    # Main directions in which these change where light has another color, each as long as the mean
    # change along it; left out where they are not known. Not compared: `identity` says it all.
    light_changes: Float[np.ndarray, "G D"] | None = dataclasses.field(default=None, compare=False)

    def __post_init__(self) -> None:
        for name in ("patch_px", "dim"):
            check_option(name, getattr(self, name), 1, _MAX_NUMBERS)
        check_option("num_background", self.num_background, 0, self.dim)
        for name in ("name", "fingerprint"):
            if not isinstance(getattr(self, name), str):
                raise OptionError(f"'{name}' is {getattr(self, name)!r}; give a text", name)

    @property
    def identity(self) -> tuple[str, str]:
        """Name and fingerprint: equal for backbones of equal features."""
        return self.name, self.fingerprint

    def extract(
        self,
        images: UInt8[np.ndarray, "B H W 3"] | UInt8[jax.Array, "B H W 3"],
        wanted: Bool[np.ndarray, "B Hp Wp"] | None = None,
    ) -> Float[jax.Array, "B Hp Wp D"]:
        """Describes every patch of every image; raw features, not normalized.

        Cropping to a multiple of the patch is the caller's part: it alone knows which part of the
        frame its masks belong to. Only shapes and types are checked, so this can be traced.

        Args:
          wanted: Patches that are asked for; all if left out. The features of others may be zero,
            which is faster for some backbones.

        Raises:
          SourceError: If the images are not such an array, or smaller than one patch.
        """
        self._check_images(images)
        if wanted is None or self.apply_to is None:
            features = self.apply(images)
        else:
            features = self.apply_to(images, wanted)
        return self._checked(features, images)

    def extract_closeups(
        self,
        images: UInt8[np.ndarray, "B S S 3"],
        wanted: Bool[np.ndarray, "B V V"] | None,
        coverage: Float[np.ndarray, "B V V"],
    ) -> Float[jax.Array, "B V V D"]:
        """`extract` for pictures of single detections.

        Args:
          coverage: Share of each patch that the detection covers, [0, 1].

        Returns:
          Features, the last `num_background` channels of the background.

        Raises:
          SourceError: As `extract`.
        """
        if self.apply_closeups is None:
            return self.extract(images, wanted)
        self._check_images(images)
        every = coverage >= 0.0
        features = self.apply_closeups(images, every if wanted is None else wanted, coverage)
        return self._checked(features, images, self.num_background + 1)

    def extract_with_attention(
        self,
        images: UInt8[np.ndarray, "B H W 3"] | UInt8[jax.Array, "B H W 3"],
        patches: Int[np.ndarray, "B K"] | Int[jax.Array, "B K"],
        heads: tuple[int, ...] | None = None,
    ) -> tuple[Float[jax.Array, "B Hp Wp D"], ObjectAttention]:
        """`extract`, and how patches of objects attend to each other; features are the same.

        Args:
          patches: Raster numbers of patches of objects, -1 in unused slots. Memory grows with
            their number squared, and one program is compiled per number of slots.

        Raises:
          SourceError: As `extract`.
          ConfigError: If the backbone has no attention, or no such head.
        """
        self._check_images(images)
        return self.check_attention()(images, patches, heads=heads)

    def check_attention(self) -> Callable[..., Any]:
        """The function behind `extract_with_attention`. Raises ConfigError if there is none."""
        if self.apply_with_attention is None:
            raise ConfigError(
                f"backbone '{self.name}' has no attention; parts by attention need a vision "
                "transformer such as 'dinov3-vits16'"
            )
        return self.apply_with_attention

    def _checked(
        self, features: Any, images: Any, least_dim: int | None = None
    ) -> Float[jax.Array, "B Hp Wp D"]:
        """What a function gave, `dim` wide if not at least so wide. Raises ConfigError if not."""
        import jax.numpy as jnp

        from remind_jax.files.host_array import host_array

        if not isinstance(features, jnp.ndarray):
            features = host_array(features, f"features of backbone '{self.name}'")
        rows, columns = (side // self.patch_px for side in images.shape[1:3])
        expected, found = (len(images), rows, columns, least_dim or self.dim), features.shape
        is_wide = least_dim is not None and len(found) == 4 and found[3] > least_dim
        fits = found == expected or (is_wide and found[:3] == expected[:3])
        if not fits or not jnp.issubdtype(features.dtype, jnp.floating):
            raise ConfigError(
                f"backbone '{self.name}' gives features of shape {found} and type {features.dtype} "
                f"for images of shape {images.shape}; floats of shape {expected} are needed"
            )
        return features

    def _check_images(self, images: Any) -> None:
        shape = tuple(images.shape)
        if len(shape) != 4 or shape[-1] != 3 or images.dtype != "uint8":
            raise SourceError(
                f"backbone '{self.name}' was given {images.dtype} images of shape {shape}; "
                "give uint8 RGB images [B, H, W, 3]"
            )
        height, width = shape[1:3]
        if min(height, width) < self.patch_px:
            raise SourceError(
                f"a frame of {width}x{height} pixels is smaller than one patch of backbone "
                f"'{self.name}'; both sides must be at least {self.patch_px} pixels"
            )
        if height % self.patch_px or width % self.patch_px:
            raise SourceError(
                f"a frame of {width}x{height} pixels does not divide into patches of "
                f"{self.patch_px} pixels; crop it to "
                f"{width - width % self.patch_px}x{height - height % self.patch_px} first"
            )


BackboneFactory = Callable[..., Backbone]

# A string is "module:function", imported when the backbone is first asked for, or
# "module:function:argument" where one function makes several.
_factories: dict[str, BackboneFactory | str] = {
    DEFAULT_BACKBONE: "remind_jax.backbone.patch_statistics:patch_statistics",
    **{name: f"remind_jax.backbone.vit_backbone:vit:{name}" for name in VARIANTS},
    "vit": "remind_jax.backbone.vit_backbone:vit_from_file",
    "onnx": "remind_jax.backbone.onnx_encoder:onnx_encoder",
}
_COMBINE = "remind_jax.backbone.combined:combine"


def register(name: str, factory: BackboneFactory | str | None = None) -> Any:
    """Adds a backbone under `name`; also a decorator: `@register("my-backbone")`.

    Args:
      name: What `get_backbone` is asked for; no colon (what follows one is handed to the factory)
        and no plus (which joins backbones).
      factory: `factory(**options) -> Backbone`, or `"module:function"` to import it when needed
        (`"module:function:argument"`: with a first argument).

    Raises:
      ConfigError: If the name is taken by another backbone or holds a colon or a plus.
    """
    if ":" in name or "+" in name or not name:
        raise ConfigError(
            f"'{name}' cannot name a backbone; use a name without a colon, which sets off what is "
            "handed to the backbone, as in 'onnx:encoder.onnx', and without a plus, which joins two"
        )

    def add(new_factory: BackboneFactory | str) -> Any:
        # The same function defined again is a notebook cell run twice, not a clash.
        if name in _factories and _origin(_factories[name]) != _origin(new_factory):
            raise ConfigError(f"a backbone '{name}' is registered already; choose another name")
        _factories[name] = new_factory
        return new_factory

    return add if factory is None else add(factory)


def list_backbones() -> tuple[str, ...]:
    """Names of all registered backbones in alphabetical order; imports none of them."""
    return tuple(sorted(_factories))


def parts_of(name: str) -> list[str]:
    """The names that pluses join, as in `"patch-statistics+onnx:encoder.onnx"`.

    A plus within a target, such as the name of a file, joins nothing unless a registered name
    follows it.
    """
    known = "|".join(map(re.escape, _factories))
    parts = []
    for part in re.split(rf"\+(?=(?:{known})(?:[:+]|$))", name):
        family, colon, target = part.partition(":")
        *before, last = family.split("+")
        parts += [*before, last + colon + target]
    return parts


def check_name(name: str) -> None:
    """Raises ConfigError if `get_backbone` does not know a name; imports no backbone."""
    parts = parts_of(name)
    if "" in parts[1:] or parts[0] == "" != name:
        raise ConfigError(
            f"backbone '{name}' has nothing before or after a plus; leave the plus out, or name "
            "what it joins"
        )
    if wrong := next((part for part, count in Counter(parts).items() if count > 1), None):
        raise ConfigError(f"backbone '{name}' joins '{wrong}' twice; name it once")
    for part in parts:
        family, colon, target = part.partition(":")
        if colon and not target:
            raise ConfigError(f"nothing follows '{part}' in backbone '{name}'; give a file")
        if family not in _factories:
            raise ConfigError(
                f"there is no backbone '{family}'; {nearest_names(family, list_backbones())}"
            )


def get_backbone(name: str | Backbone = DEFAULT_BACKBONE, **options: Any) -> Backbone:
    """Makes the backbone called `name`; one that was made already is given back.

    Args:
      name: A registered name, or `"NAME:TARGET"` for a backbone that reads `TARGET`, usually a
        file; the target becomes the first argument of its factory. Several, joined by pluses, see
        a frame one beside the other (`combined.combine`).

    Raises:
      ConfigError: If there is no such backbone or it does not take such an option.
    """
    if isinstance(name, Backbone):
        if options:
            raise ConfigError(
                f"'{next(iter(options))}' is no option here, and a finished backbone takes none; "
                "leave it out, or give the backbone by name"
            )
        return name
    if not isinstance(name, str):
        raise ConfigError(
            f"the backbone is of type {type(name).__name__}; give the name of one, or one that was "
            "made by 'remind_jax.backbone.get_backbone'"
        )
    check_name(name)
    parts = parts_of(name)
    if len(parts) > 1:
        if options:
            raise ConfigError(
                f"'{name}' joins several backbones and takes no option ({', '.join(options)}); "
                "weights of one are named after a colon, 'vit:FILE'"
            )
        return _import(_COMBINE)([get_backbone(part) for part in parts])
    family, colon, target = name.partition(":")
    factory = _factories[family]
    if isinstance(factory, str):
        factory = _import(factory)
    targets = (target,) if colon else ()
    _check_call(family, factory, targets, options)
    made = factory(*targets, **options)
    if not isinstance(made, Backbone):
        raise ConfigError(
            f"the factory of backbone '{name}' returns {type(made).__name__}; it must return a "
            "Backbone"
        )
    return made


def _import(place: str) -> Callable[..., Any]:
    """The function at `"module:function"`, with the arguments that follow it."""
    module, function, *arguments = place.split(":")
    return functools.partial(getattr(importlib.import_module(module), function), *arguments)


def _origin(factory: BackboneFactory | str) -> str:
    """Where a factory is defined, `"module:function"`."""
    if isinstance(factory, str):
        return factory
    return f"{factory.__module__}:{factory.__qualname__}"


def _check_call(
    name: str, factory: BackboneFactory, targets: tuple[str, ...], options: dict[str, Any]
) -> None:
    """Raises a `ConfigError` if the factory cannot be called like this."""
    parameters = inspect.signature(factory).parameters
    named = [key for key, one in parameters.items() if one.kind is not one.VAR_KEYWORD]
    unknown = next((key for key in options if key not in named), None)
    if unknown is not None and len(named) == len(parameters):
        hint = (
            nearest_names(unknown, named)
            if unknown != "weights"
            else "it needs none, leave them out"
        )
        raise ConfigError(
            f"'{unknown}' is no option here, and backbone '{name}' has no such option; {hint}"
        )
    try:
        inspect.signature(factory).bind(*targets, **options)
    except TypeError as error:
        raise ConfigError(
            f"backbone '{name}': {error}; give a file after a colon, '{name}:FILE', or as weights "
            "(--weights FILE), to what needs one"
        ) from error
