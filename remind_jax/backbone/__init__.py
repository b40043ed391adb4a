"""Frozen patch features behind one registry; the embedded default needs no weights."""

from remind_jax.backbone.registry import DEFAULT_BACKBONE as DEFAULT_BACKBONE
from remind_jax.backbone.registry import Backbone as Backbone
from remind_jax.backbone.registry import get_backbone as get_backbone
from remind_jax.backbone.registry import list_backbones as list_backbones
from remind_jax.backbone.registry import register as register
