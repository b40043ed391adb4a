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
# Features, detectors, trackers and rules are yours to replace; sources, outputs and evaluation stay.
# You learn to plug in
#
# * a detector: any function from an image to masks;
# * a backbone: any function from images to patch features, and a network in an ONNX file;
# * a tracker of your own, as two pure functions;
# * a rule around any tracker, and a rule inside REMIND.
#
# The same with more words: [Extension points](../docs/extension_points.md).

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
COLOURS = np.array([(230, 70, 30), (50, 100, 225), (235, 225, 70), (30, 190, 130)])
PLACES_PX = (60, 170, 280, 390)  # along the wall
PAN_PX = [*range(0, 289, 24), *range(0, 193, 24)]  # left end of the view, frame by frame
CUT = 13  # first frame after the cut

wall = np.full((96, 480, 3), 90, np.uint8)
for colour, place_px in zip(COLOURS.tolist(), PLACES_PX):
    cv2.circle(wall, (place_px, 48), 24, colour, -1)
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
# Any function from an RGB frame to instances: `rj.Detections`, `supervision.Detections`, masks, or a
# mapping. This one takes connected colourful regions. It finds nothing that is not there, so the runs
# below give ids at once (`announce_after=1`), not to what was found five times.


# %%
def find_discs(image):
    colourful = np.ptp(image.astype(int), axis=-1) > 40
    count, pieces = cv2.connectedComponents(colourful.astype(np.uint8))
    masks = pieces == np.arange(1, count)[:, None, None]
    return {"masks": masks, "labels": ["disc"] * len(masks)}


print(len(find_discs(video[0])["masks"]), "discs in the first frame")

# %% [markdown]
# ## A backbone
#
# A factory that makes a `Backbone`: a function from images (uint8 `[B, H, W, 3]`) to raw features
# `[B, Hp, Wp, D]`, one vector per patch. `fingerprint` must change whenever features may, since cached
# features are found by it.

# %%
from remind_jax.backbone import Backbone, get_backbone, register


@register("mean-colour")
def mean_colour(patch_px: int = 16) -> Backbone:
    """Mean and spread of the colour of every patch."""

    @jax.jit
    def describe(images):
        batch, height, width, _ = images.shape
        rows, columns = height // patch_px, width // patch_px
        cells = jnp.asarray(images, jnp.float32) / 255 - 0.5  # grey says nothing
        cells = cells.reshape(batch, rows, patch_px, columns, patch_px, 3)
        return jnp.concatenate([cells.mean((2, 4)), cells.std((2, 4))], axis=-1)

    return Backbone("mean-colour", patch_px, 6, describe, fingerprint=f"1,{patch_px}")


eyes = get_backbone("mean-colour", patch_px=8)
features = np.asarray(eyes.extract(video[0][None])[0])

figure, (left, right) = plt.subplots(1, 2, figsize=(8, 2.2))
left.imshow(video[0])
left.set_title("frame 0")
right.imshow(np.clip(features[..., :3] + 0.5, 0, 1))
right.set_title("its features 0 to 2, as colour")
for axis in (left, right):
    axis.set_axis_off()
figure.tight_layout()
plt.show()

# %% [markdown]
# `rj.run` takes it by name or ready made. A network needs no code: `backbone="onnx:encoder.onnx"`, and
# features of another program can come as a [file](../docs/file_formats.md). Here with the baseline
# tracker `bank`, which keeps several looks of each object:

# %%
result = rj.run(video, detector=find_discs, announce_after=1, backbone=eyes, tracker="bank")


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
                colour = tuple(COLOURS[disc] / 255) if object_id >= 0 else "white"
                axis.add_patch(
                    plt.Rectangle((at - 0.46, disc - 0.42), 0.92, 0.84, color=colour, ec="0.4")
                )
                text = str(object_id) if object_id >= 0 else "-"
                axis.text(at, disc, text, ha="center", va="center", fontsize=9)
        axis.axvline(CUT - 0.5, color="black", linestyle="--", linewidth=1)
        axis.set(
            xlim=(-0.6, len(PAN_PX) - 0.4),
            ylim=(len(COLOURS) - 0.5, -0.5),
            ylabel="disc",
            title=title,
        )
        axis.set_yticks(range(len(COLOURS)))
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
# A `Method` is two pure functions and a dataclass of numbers. `init` makes an empty memory of fixed
# shapes, `step` takes it from one frame to the next; `remind_jax.baselines` has parts to build from.
# This one knows places only: whoever is nearest is it.

# %%
from remind_jax.baselines.scene_memory import Matching, conclude, empty_memory, same_class
from remind_jax.method import Method, get_method, register_method
from remind_jax.solvers.greedy import assign_greedily


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class NearestThresholds:
    """Numbers of the nearest neighbour."""

    reach_px: float = 40.0  # an object is not looked for further away


def init(static):
    return empty_memory(static, jnp.zeros((static.num_objects, 2)))  # last centre of each object


def step(state, frame_feats, masks, *, static, thresholds):
    apart_px = jnp.linalg.norm(masks.center[:, None] - state.looks[None], axis=-1)
    least = jnp.full(len(masks.valid), -thresholds.reach_px)
    column = assign_greedily(-apart_px, same_class(state, masks), least, jnp.array(True))

    def learn(centers, slot, starts):
        return centers.at[slot].set(masks.center, mode="drop")

    matching = Matching(-apart_px, same_class(state, masks), column, masks.valid, masks.valid)
    return conclude(state, masks, matching, learn, static)


register_method(Method("nearest", NearestThresholds, init, step))
near = rj.run(video, detector=find_discs, announce_after=1, backbone=eyes, tracker="nearest")

# %% [markdown]
# Its numbers are settings like any other: in a dictionary, or in a YAML file for `--config`.

# %%
config = {"tracker": "nearest", "thresholds": {"reach_px": 10.0}}
short = rj.run(video, detector=find_discs, announce_after=1, backbone=eyes, config=config)
draw_identities({"'nearest', reach 40 px": near, "'nearest', reach 10 px": short})

# %% [markdown]
# It follows a disc until that comes to where another one was last seen, and takes its id; after the cut
# nothing is right. A shorter reach than the motion of a frame only makes more identities. Places on
# the screen do not survive a moving camera; looks do.
#
# ## A rule around any tracker
#
# Rules about what a tracker may see need nothing of its inside: change what goes into its step. Here
# masks that touch the border of the image are left out.


# %%
def without_border(name):
    inner = get_method(name)

    def step(state, frame_feats, masks, **options):
        whole = masks.valid & ~masks.relations.touches_border
        seen = dataclasses.replace(masks, valid=whole)
        return inner.step(state, frame_feats, seen, **options)

    return dataclasses.replace(inner, name=f"{name}-without-border", step=step)


register_method(without_border("bank"))
whole = rj.run(
    video, detector=find_discs, announce_after=1, backbone=eyes, tracker="bank-without-border"
)
draw_identities({"'bank', discs that touch the border left out": whole})

# %% [markdown]
# ## A rule inside REMIND
#
# `remind_jax/remind/tracker.py` is the whole chain on one page, and each stage is a pure function in the
# package named for it. Between perception and the rest there is a seam, `step_described`: here parts
# of small objects are not trusted.
#
# A tracker by another name starts from the published thresholds of REMIND, made for other features.

# %%
from remind_jax.remind import tracker
from remind_jax.remind.perception.description import describe


def careful_step(state, frame_feats, masks, *, static, thresholds):
    numbers = thresholds.as_arrays(static.scalar)
    looks = describe(frame_feats, masks, static, numbers)
    large = looks.patch_sum >= 16.0  # effective patches
    looks = dataclasses.replace(looks, parts_valid=looks.parts_valid & large[:, None, None])
    return tracker.step_described(state, looks, masks, static=static, thresholds=thresholds)


careful = dataclasses.replace(get_method("remind"), name="careful", step=careful_step)
register_method(dataclasses.replace(careful, step_traced=None))
capacities = {"num_detections": 4, "num_objects": 8, "num_pending": 4}  # they grow if need be
inside = rj.run(
    video,
    detector=find_discs,
    announce_after=1,
    backbone=eyes,
    config={"tracker": "careful", "static": capacities},
)
draw_identities({"REMIND with the rule inside": inside})

# %% [markdown]
# ## From the command line
#
# Names registered in Python are known to that process. Put registrations into a file of yours that
# ends with
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
# its numbers. What you plug in is compiled, swept, drawn and scored like what ships.
