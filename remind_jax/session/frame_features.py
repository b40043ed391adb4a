"""Patch features of a stream's frames, with the attention between objects where it is wanted."""

from __future__ import annotations

from typing import Literal

import cv2
import jax
import numpy as np
from jaxtyping import Bool, Float

from remind_jax.backbone.registry import Backbone
from remind_jax.errors import ConfigError, SourceError
from remind_jax.masks.closeups import CLOSEUP_PATCHES, Closeups
from remind_jax.method import Method
from remind_jax.observation import AnyFeats, CloseupFeats, FrameFeats, PatchAttention
from remind_jax.session.preparation import Prepared
from remind_jax.static import Static

CLOSEUPS_AT_ONCE = 8
_FIRST_SLOTS = 256  # object patches whose attention is kept; doubles with the need


class FrameFeatures:
    """Describes frames by a backbone, or takes the features that they bring.

    Attributes:
      attention_slots: Object patches whose attention there is room for.
      with_closeups: Whether detections are described in closeups.
    """

    def __init__(
        self,
        method: Method,
        backbone: Backbone,
        closeups: Literal["auto", "always", "never"] = "never",
    ) -> None:
        """Describes in closeups as `input.closeups` says.

        Raises:
          ConfigError: If closeups are to be described, and the method reads none.
        """
        self._method, self._backbone = method, backbone
        self.attention_slots = _FIRST_SLOTS
        if closeups == "always" and not method.needs.reads_closeups:
            raise ConfigError(
                f"input.closeups is 'always', but tracker '{method.name}' reads features of the "
                "frame only; leave it at 'auto' or choose another tracker"
            )
        self.with_closeups = closeups == "always" or (
            closeups == "auto"
            and method.needs.prefers_closeups
            and backbone.apply_closeups is not None
        )

    @property
    def described_by(self) -> str:
        """What looks in memory can be compared with."""
        how = f", closeups of {CLOSEUP_PATCHES} patches" if self.with_closeups else ""
        return f"{self._backbone.name}{how}"

    def check(self, static: Static) -> None:
        """Makes sure that the backbone has what the method wants.

        Raises:
          ConfigError: If it has no attention, which is wanted.
        """
        if self._attention_heads(static) is not None:
            self._backbone.check_attention()

    def describe(self, prepared: Prepared, static: Static) -> AnyFeats:
        """As `Tracker.describe`: features of closeups if it was prepared with such; ready."""
        size = np.array(prepared.frame.size, np.int32)
        if prepared.features is not None:
            return FrameFeats(prepared.features, size)
        if prepared.image is None:
            raise SourceError(
                f"frame '{prepared.frame.name}' has neither an image nor patch features"
            )
        if prepared.closeups is not None:
            patches = self._describe_closeups(prepared.closeups)
            dim = patches.shape[-1]
            is_background = np.arange(dim) >= dim - self._backbone.num_background
            changes = self._backbone.light_changes
            changes = np.zeros((0, dim), np.float32) if changes is None else changes
            return CloseupFeats(patches, prepared.closeups.coverage, is_background, changes, size)
        images = prepared.image[None]
        heads = self._attention_heads(static)
        covered = np.any(np.asarray(prepared.masks.coverage) > 0, axis=0)
        if heads is None:
            features = self._backbone.extract(images, self._near(covered[None]))[0]
            return FrameFeats(jax.block_until_ready(features), size)
        patches = np.flatnonzero(covered)
        while self.attention_slots < len(patches):
            self.attention_slots *= 2
        slots = np.full(self.attention_slots, -1, np.int32)
        slots[: len(patches)] = patches
        extracted = self._backbone.extract_with_attention(images, slots[None], heads or None)
        features, paid = jax.block_until_ready(extracted)
        attention = PatchAttention(slots, paid.row_sums[0], paid.block[0])
        return FrameFeats(features[0], size, attention)

    def _describe_closeups(self, closeups: Closeups) -> Float[np.ndarray, "N V V D"]:
        """Some at a time, so that one program serves any number of them."""
        num = len(closeups)
        # One batch at least, so that a warm-up without detections compiles what they will need.
        num_slots = max(1, -(-num // CLOSEUPS_AT_ONCE)) * CLOSEUPS_AT_ONCE
        lacking = ((0, num_slots - num), (0, 0), (0, 0))
        images = np.pad(closeups.images, (*lacking, (0, 0)))
        coverage = np.pad(closeups.coverage, lacking)
        wanted = self._near(coverage > 0)
        features = []
        for first in range(0, num_slots, CLOSEUPS_AT_ONCE):
            batch = slice(first, first + CLOSEUPS_AT_ONCE)
            near = None if wanted is None else wanted[batch]
            features.append(self._backbone.extract_closeups(images[batch], near, coverage[batch]))
        return np.concatenate([np.asarray(some) for some in features])[:num]

    def _near(self, covered: Bool[np.ndarray, "K Hp Wp"]) -> Bool[np.ndarray, "K Hp Wp"] | None:
        """Patches whose features the method reads, beside covered ones; None for all."""
        reach = self._method.needs.patch_reach
        if reach is None:
            return None
        square = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        return np.stack([cv2.dilate(one.view(np.uint8), square).view(bool) for one in covered])

    def _attention_heads(self, static: Static) -> tuple[int, ...] | None:
        """Those whose attention the method reads; None if it reads none."""
        of = self._method.needs.attention_heads
        return None if of is None else of(static)
