# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # 05 Your own backbone, detector or rule
#
# You can replace features, detectors, trackers and rules; sources, outputs and evaluation stay the same.
# You learn to plug in
#
# * a detector: any function from an image to masks;
# * a backbone: any function from images to patch features, and a network in an ONNX file;
# * a tracker of your own, as pure functions;
# * a rule around any tracker, and a rule inside REMIND.
#
# In more detail: [Extension points](../docs/extension_points.md).

# %%
import dataclasses

import cv2
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import remind_jax as rj

plt.rcParams.update({"figure.dpi": 80, "axes.spines.top": False, "axes.spines.right": False})

# %% [markdown]
# ## A small world
#
# A camera pans along a wall with four discs; then the video is cut, and the pan starts again.

# %%
COLORS = np.array([(230, 70, 30), (50, 100, 225), (235, 225, 70), (30, 190, 130)])
PLACES_PX = (60, 170, 280, 390)  # along the wall
PAN_PX = [*range(0, 289, 24), *range(0, 193, 24)]  # left end of the view, frame by frame
CUT = 13  # first frame after the cut

wall = np.full((96, 480, 3), 90, np.uint8)
for color, place_px in zip(COLORS.tolist(), PLACES_PX):
    cv2.circle(wall, (place_px, 48), 24, color, -1)
video = [np.ascontiguousarray(wall[:, left : left + 192]) for left in PAN_PX]

figure, axes = plt.subplots(1, 5, figsize=(11, 1.6))
for axis, index in zip(axes, (0, 4, 12, 13, 18)):
    axis.imshow(video[index])
    axis.set_title(f"frame {index}")
    axis.set_axis_off()
figure.tight_layout()
plt.show()

# %% [markdown]
# ## A detector
#
# A detector is any function from an RGB frame to instances: `rj.Detections`, `supervision.Detections`,
# masks, or a mapping. This one takes connected colorful regions. It has no false detections, so the runs
# below give ids at once (`announce_after=1`), and not only after five detections.


# %%
def find_discs(image):
    colorful = np.ptp(image.astype(int), axis=-1) > 40
    count, pieces = cv2.connectedComponents(colorful.astype(np.uint8))
    masks = pieces == np.arange(1, count)[:, None, None]
    return {"masks": masks, "labels": ["disc"] * len(masks)}


print(len(find_discs(video[0])["masks"]), "discs in the first frame")

# %% [markdown]
# ## A backbone
#
# A backbone is registered as a factory that makes a `Backbone`: a function from images (uint8
# `[B, H, W, 3]`) to raw features `[B, Hp, Wp, D]`, one vector per patch. Cached features are found by
# `fingerprint`; it must change whenever the features may change.

# %%
from remind_jax.backbone import Backbone, get_backbone, register


@register("mean-color")
def mean_color(patch_px: int = 16) -> Backbone:
    """Mean and spread of the color of every patch."""

    @jax.jit
    def describe(images):
        batch, height, width, _ = images.shape
        rows, columns = height // patch_px, width // patch_px
        cells = jnp.asarray(images, jnp.float32) / 255 - 0.5  # gray is zero
        cells = cells.reshape(batch, rows, patch_px, columns, patch_px, 3)
        return jnp.concatenate([cells.mean((2, 4)), cells.std((2, 4))], axis=-1)

    return Backbone("mean-color", patch_px, 6, describe, fingerprint=f"1,{patch_px}")


backbone = get_backbone("mean-color", patch_px=8)
features = np.asarray(backbone.extract(video[0][None])[0])

figure, (left, right) = plt.subplots(1, 2, figsize=(8, 2.2))
left.imshow(video[0])
left.set_title("frame 0")
right.imshow(np.clip(features[..., :3] + 0.5, 0, 1))
right.set_title("its features 0 to 2, as color")
for axis in (left, right):
    axis.set_axis_off()
figure.tight_layout()
plt.show()

# %% [markdown]
# `rj.run` takes a backbone by name or as an object. A network needs no code:
# `backbone="onnx:encoder.onnx"`. Features of another program are given frame by
# frame: `rj.Frame(..., features=array)`. Here with the baseline tracker `bank`, which keeps several prototypes of
# each object:

# %%
result = rj.run(video, detector=find_discs, announce_after=1, backbone=backbone, tracker="bank")


def true_disc(tracks, row):
    """Which disc it is, by its place on the wall."""
    box = tracks.boxes[row]
    along_px = PAN_PX[tracks.frame_index] + (box[0] + box[2]) / 2
    return int(np.argmin(np.abs(np.array(PLACES_PX) - along_px)))


def draw_identities(results):
    """Which id every disc had in every frame, for several runs."""
    figure, axes = plt.subplots(
        len(results), 1, figsize=(10, 0.5 + 1.6 * len(results)), sharex=True, squeeze=False
    )
    for axis, (title, result) in zip(axes[:, 0], results.items()):
        for tracks in result.tracks:
            for row, object_id in enumerate(tracks.object_id):
                disc, at = true_disc(tracks, row), tracks.frame_index
                color = tuple(COLORS[disc] / 255) if object_id >= 0 else "white"
                axis.add_patch(
                    plt.Rectangle((at - 0.46, disc - 0.42), 0.92, 0.84, color=color, ec="0.4")
                )
                text = str(object_id) if object_id >= 0 else "-"
                axis.text(at, disc, text, ha="center", va="center", fontsize=9)
        axis.axvline(CUT - 0.5, color="black", linestyle="--", linewidth=1)
        axis.set(
            xlim=(-0.6, len(PAN_PX) - 0.4),
            ylim=(len(COLORS) - 0.5, -0.5),
            ylabel="disc",
            title=title,
        )
        axis.set_yticks(range(len(COLORS)))
        axis.set_xticks(range(0, len(PAN_PX), 3))
    axes[-1, 0].set_xlabel("frame (dashed: the cut); numbers: the identity given, '-': none")
    figure.tight_layout()
    plt.show()


draw_identities({"own features, own detector, tracker 'bank'": result})

# %% [markdown]
# Thresholds belong to features. With features of your own, tune them on scenes of your own (notebook 03).

# %% [markdown]
# ## A tracker
#
# A `Method` is pure functions and a dataclass of settings. `init` makes an empty memory of fixed shapes,
# `decide` takes it from one frame to the next; `remind_jax.baselines` has parts to build from.
# This one knows only positions: each detection is matched to the nearest object.

# %%
from remind_jax.baselines.parts.scene_memory import Matching, conclude, empty_memory, same_class
from remind_jax.solvers.greedy import assign_greedily


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class NearestSettings:
    """Numbers of the nearest neighbor."""

    reach_px: float = 40.0  # an object further away is not matched


def init(static):
    return empty_memory(static, jnp.zeros((static.num_objects, 2)))  # last center of each object


def decide(state, seen, *, static, thresholds):
    masks = seen.masks
    apart_px = jnp.linalg.norm(masks.center[:, None] - state.looks[None], axis=-1)
    least = jnp.full(len(masks.valid), -thresholds.reach_px)
    column = assign_greedily(-apart_px, same_class(state, masks), least, jnp.array(True))

    def learn(centers, slot, starts):
        return centers.at[slot].set(masks.center, mode="drop")

    matching = Matching(-apart_px, same_class(state, masks), column, masks.valid, masks.valid)
    return conclude(state, masks, matching, learn, static), None  # no trace


rj.register_method(rj.Method("nearest", NearestSettings, init, decide))
near = rj.run(video, detector=find_discs, announce_after=1, backbone=backbone, tracker="nearest")

# %% [markdown]
# Its thresholds are settings like any other: in a dictionary, or in a YAML file for `--config`.

# %%
config = {"tracker": "nearest", "thresholds": {"reach_px": 10.0}}
short = rj.run(video, detector=find_discs, announce_after=1, backbone=backbone, config=config)
draw_identities({"'nearest', reach 40 px": near, "'nearest', reach 10 px": short})

# %% [markdown]
# A disc keeps its id until it comes to where another one was last seen, and then takes that one's id;
# after the cut nothing is right. A reach shorter than the motion of a frame only makes more identities.
# With a moving camera, positions in the image do not identify objects; appearance does.
#
# ## A rule around any tracker
#
# A rule about what enters a tracker is put around `describe`, one about what leaves it around `decide`.
# Here masks that touch the border of the image are left out.


# %%
def without_border(name):
    inner = rj.get_method(name)

    def describe(frame_feats, masks, observed, **options):
        whole = masks.valid & ~masks.relations.touches_border
        seen = dataclasses.replace(masks, valid=whole)
        return inner.describe(frame_feats, seen, observed, **options)

    return dataclasses.replace(inner, name=f"{name}-without-border", describe=describe)


rj.register_method(without_border("bank"))
whole = rj.run(
    video, detector=find_discs, announce_after=1, backbone=backbone, tracker="bank-without-border"
)
draw_identities({"'bank', discs that touch the border left out": whole})

# %% [markdown]
# ## A rule inside REMIND
#
# `remind_jax/remind/tracker.py` is the whole chain on one page, and each stage is a pure function in the
# package named for it. What it makes of a frame passes between the halves of its step, where a rule can
# change it: here parts of small objects are not used.
#
# A tracker under another name starts from the published thresholds of REMIND, made for other features.


# %%
def careful():
    inner = rj.get_method("remind")

    def describe(frame_feats, masks, observed, **options):
        seen = inner.describe(frame_feats, masks, observed, **options)
        large = seen.descriptors.patch_sum >= 16.0  # effective patches
        valid = seen.descriptors.parts_valid & large[:, None, None]
        descriptors = dataclasses.replace(seen.descriptors, parts_valid=valid)
        return dataclasses.replace(seen, descriptors=descriptors)

    return dataclasses.replace(inner, name="careful", describe=describe)


rj.register_method(careful())
capacities = {"num_detections": 4, "num_objects": 8, "num_pending": 4}  # they grow if need be
inside = rj.run(
    video,
    detector=find_discs,
    announce_after=1,
    backbone=backbone,
    config={"tracker": "careful", "static": capacities},
)
draw_identities({"REMIND with the rule inside": inside})

# %% [markdown]
# ## From the command line
#
# Names registered in Python are known only in that process. Put your registrations into a file that ends
# with
#
# ```python
# from remind_jax.cli.main import main
#
# sys.exit(main())
# ```
#
# and `python mine.py run rooms.mp4 --tracker nearest` works as `remind run` does.
#
# **Take-away.** A detector is a function, a backbone a function and a name, a tracker two functions and
# its thresholds. Your own parts are compiled, swept, drawn and scored like the shipped ones.
