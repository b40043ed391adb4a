"""`Input`: how frames and masks are prepared before the tracker sees them."""

from __future__ import annotations

import dataclasses
from typing import Literal

from remind_jax.settings.checks import check_fields
from remind_jax.settings.record import setting

# fmt: off


@dataclasses.dataclass(frozen=True)
class Input:
    """How frames and masks are prepared on the host.

    Rules: method.md#frame-size, method.md#filled-mask.
    """

    max_width_px: int = setting(1280, "wider frames are reduced to this width", "px",
        more="finer patches of wide frames, more time", key="system.input_width_size")
    center_crop: bool = setting(True,
        "crop to whole patches around the center, else at the top left",
        key="perception.full_center_crop")
    ignored_classes: tuple[str, ...] = setting(("wall", "floor", "ceiling", "object"),
        "detections of these classes are left out", key="detector.ignored_classes")
    sanitize: Literal["convex_hull", "morphology", "none"] = setting("convex_hull",
        "how a mask is filled before its surroundings are described",
        decided_by=("bg_local.sanitize.enabled", "bg_local.sanitize.mode"))
    keep_largest: bool = setting(False,
        "look at the background around the largest piece of a mask only",
        key="bg_local.sanitize.keep_largest_component")
    fill_holes: bool = setting(True, '"morphology": fill holes', key="bg_local.sanitize.fill_holes")
    close_px: int = setting(3, '"morphology": side of the closing square', "px",
        more="larger gaps in masks are closed", least=0, most=1000,
        why="which is wider than things are",
        key="bg_local.sanitize.close_px")
    open_px: int = setting(0, '"morphology": side of the opening square, 0: none', "px",
        more="larger specks of masks vanish", least=0, most=1000,
        why="which is wider than things are",
        key="bg_local.sanitize.open_px")
    erosion_px: int = setting(0, "masks lose so many pixels on every side first", "px",
        more="masks shrink more; less background in the appearance", least=0, most=1000,
        why="which is wider than things are",
        decided_by=("davis.mask_erosion_px", "davis.mask_erosion_iters"))
    closeups: Literal["auto", "always", "never"] = setting("auto",
        "describe every detection in a picture of its own instead of the frame; \"auto\": if the "
        "tracker prefers that, and the backbone needs little time for it")
    announce_after: int = setting(0,
        "detections after which an object gets its id. 0: 1 for given masks, 5 for a detector",
        "detections", more="fewer objects that never were, each known later", least=0)
    keep_pictures: bool = setting(True,
        "keep up to three small pictures of each object in memory and its file")

    # fmt: on

    def __post_init__(self) -> None:
        check_fields(self, "input")
