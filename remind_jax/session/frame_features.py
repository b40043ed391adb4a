"""Patch features of a stream's frames, with the attention between objects where it is wanted."""

from __future__ import annotations

import cv2
import jax
import numpy as np
from jaxtyping import Bool

from remind_jax.backbone.registry import Backbone
from remind_jax.errors import SourceError
from remind_jax.method import Method
from remind_jax.observation import FrameFeats, PatchAttention
from remind_jax.session.preparation import Prepared
from remind_jax.static import Static

_FIRST_SLOTS = 256  # object patches whose attention is kept; doubles with the need


class FrameFeatures:
    """Describes frames by a backbone, or takes the features that they bring.

    Attributes:
      attention_slots: Object patches that there is room for.
    """

    def __init__(self, method: Method, backbone: Backbone) -> None:
        self._method, self._backbone = method, backbone
        self.attention_slots = _FIRST_SLOTS

    def check(self, static: Static) -> None:
        """Makes sure that the backbone has what the method wants.

        Raises:
          ConfigError: If it has no attention, which is wanted.
        """
        if self._wants_attention(static):
            self._backbone.check_attention()

    def describe(self, prepared: Prepared, static: Static) -> FrameFeats:
        """The features of a frame, on the device and ready.

        Raises:
          SourceError: If it has neither an image nor features.
        """
        size = np.array(prepared.frame.size, np.int32)
        if prepared.features is not None:
            return FrameFeats(prepared.features, size)
        if prepared.image is None:
            raise SourceError(
                f"frame '{prepared.frame.name}' has neither an image nor patch features"
            )
        images = prepared.image[None]
        if not self._wants_attention(static):
            features = self._backbone.extract(images, self._wanted_patches(prepared))[0]
            return FrameFeats(jax.block_until_ready(features), size)
        patches = np.flatnonzero(np.any(prepared.masks.coverage > 0, axis=0))
        while self.attention_slots < len(patches):
            self.attention_slots *= 2
        slots = np.full(self.attention_slots, -1, np.int32)
        slots[: len(patches)] = patches
        heads = static.attention_heads or None
        extracted = self._backbone.extract_with_attention(images, slots[None], heads)
        features, paid = jax.block_until_ready(extracted)
        attention = PatchAttention(slots, paid.row_sums[0], paid.block[0])
        return FrameFeats(features[0], size, attention)

    def _wanted_patches(self, prepared: Prepared) -> Bool[np.ndarray, "1 Hp Wp"] | None:
        """Those whose features the method reads; None for all."""
        reach = self._method.patch_reach
        if reach is None:
            return None
        covered = np.any(np.asarray(prepared.masks.coverage) > 0, axis=0).view(np.uint8)
        near = cv2.dilate(covered, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
        return near[None].view(bool)

    def _wants_attention(self, static: Static) -> bool:
        """Whether parts come from attention."""
        wants = self._method.wants_attention
        return wants is not None and wants(static)
