"""Frozen patch features behind one registry; the embedded default needs no weights."""

from remind_jax.backbone.registry import (
    DEFAULT_BACKBONE,
    Backbone,
    get_backbone,
    list_backbones,
    register,
)

__all__ = ["DEFAULT_BACKBONE", "Backbone", "get_backbone", "list_backbones", "register"]
