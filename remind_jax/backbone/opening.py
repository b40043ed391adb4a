"""From what a user says about features to a backbone."""

from __future__ import annotations

from pathlib import Path

from remind_jax.backbone.registry import Backbone, check_name, get_backbone, parts_of
from remind_jax.backbone.vit_variants import VARIANTS
from remind_jax.errors import ConfigError


def open_backbone(
    backbone: str | Backbone,
    *,
    weights: str | Path | None = None,
    feature_cache: str | Path | None = None,
    quiet: bool = False,
) -> Backbone:
    """A backbone by name with its weights, which keeps features if asked to.

    Raises:
      ConfigError: If the name is unknown, or weights are given to what takes none.
      WeightsError: If there are no weights, or they do not fit.
      OutputError: If the folder cannot be made.
    """
    if isinstance(backbone, str):
        obtain_named(backbone, weights, quiet=quiet)
        options = {} if weights is None else {"weights": weights}
        backbone = get_backbone(backbone, **options)
    elif weights is not None:
        raise ConfigError(
            f"weights '{weights}' were given beside the finished backbone '{backbone.name}'; give "
            "the backbone by name"
        )
    if feature_cache is None:
        return backbone
    from remind_jax.backbone.feature_cache import cache_features

    return cache_features(backbone, feature_cache)


def obtain_named(backbone: str | Backbone, weights: str | Path | None, *, quiet: bool) -> None:
    """Sees to it that a published network has weights: fetches them if there are none.

    For those who show something of their own while a backbone is opened, beforehand.

    Raises:
      ConfigError: If the name is unknown.
      WeightsError: If there are none and they cannot be fetched.
      OutputError: If they cannot be kept.
    """
    if weights is not None or not isinstance(backbone, str):
        return
    check_name(backbone)
    for name in parts_of(backbone):
        if name in VARIANTS:
            from remind_jax.backbone.weights_download import obtain_weights

            obtain_weights(name, quiet=quiet)
