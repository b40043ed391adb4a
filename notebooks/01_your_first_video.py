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
# # 01 Your first video
#
# A camera leaves a room and comes back later, in worse light. Which box is which? You learn
#
# * how to run the tracker on frames with instance masks, and what it leaves behind;
# * to read the overlay and the report;
# * how sure an answer is, and what *ambiguous* and *provisional* mean;
# * how to save the memory and continue from it later.
#
# Nothing is downloaded: the video is rendered here, with exact masks and known identities.

# %%
import tempfile
from collections import Counter
from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image, Markdown

import remind_jax as rj
from remind_jax.outputs.overlay import draw_overlay
from remind_jax.synthetic import LookalikeGroup, SceneOptions, render_sequence

plt.rcParams.update({"figure.dpi": 80, "axes.spines.top": False, "axes.spines.right": False})
work = Path(tempfile.mkdtemp())


def show(image, width_px=960):
    """An RGB image as a small JPEG."""
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    if bgr.shape[1] > width_px:
        height_px = round(bgr.shape[0] * width_px / bgr.shape[1])
        bgr = cv2.resize(bgr, (width_px, height_px), interpolation=cv2.INTER_AREA)
    data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 75])[1].tobytes()
    return Image(data, format="jpeg", width=bgr.shape[1])


def tile(images, columns=3):
    """Images of one size side by side."""
    rows = [np.hstack(images[i : i + columns]) for i in range(0, len(images), columns)]
    return np.vstack(rows)


# %% [markdown]
# ## A video
#
# Two rooms of seven objects each. In the first one stand three mugs that differ in their glaze,
# and two boxes that are exactly the same.

# %%
options = SceneOptions(
    name="tour",
    seed=7,
    width=480,
    height=352,
    frames=60,
    absence_frames=20,  # spent in the second room
    objects_per_room=7,
    lookalikes=(LookalikeGroup("mug", 3, "glaze"), LookalikeGroup("box", 2, "identical")),
    light_drop=0.3,  # lamps go down to 30 % during the absence
    min_mask_px=300,  # smaller masks are left out
)
tour = render_sequence(options)
((left, back),) = tour.scene.path.away
print(f"{len(tour.frames)} frames; away from the first room in frames {left} to {back - 1}")

first = tour.frames[0]
print(
    "a frame:",
    first.image.shape,
    first.image.dtype,
    "with",
    len(first.detections),
    "masks of",
    ", ".join(first.detections.labels),
)

# %%
SHOWN = (2, 8, 14, 20, 30, 40, 46, 50, 54)
show(tile([tour.frames[i].image for i in SHOWN]), 800)

# %% [markdown]
# ## Run
#
# One call. The source may also be a video file, a folder of images or an array; masks may come from
# files or from a detector. What runs is the default tracker, REMIND plus. The first frame compiles it,
# which takes about ten seconds the first time on a machine; every further frame takes milliseconds.

# %%
result = rj.run(
    tour.frames, out=work / "tour", name="tour", image_fps=options.fps, overwrite=True
)

summary = result.summary()
print(
    summary["detections"],
    "detections,",
    summary["identities"],
    "identities,",
    summary["returns"],
    "returns",
)
for outcome, share in summary["outcome_shares"].items():
    print(f"{outcome:20s} {share:6.1%}")

# %% [markdown]
# ## Overlay
#
# Every identity has a color. An undecided detection would be white and labeled with its candidates.

# %%
show(tile([draw_overlay(tour.frames[i].image, result.tracks[i]) for i in SHOWN]), 1080)

# %% [markdown]
# The same as a video is `overlay.mp4` in the output folder.
#
# ## Timeline and gallery
#
# `report.html` beside it has a timeline, one line per identity: bars where it was seen, thin lines where
# an undecided detection may belong to it, and a mark at each return after an absence. Below it is the best
# view of each visit of every identity: the quickest way to spot a mistake.

# %% [markdown]
# ## How sure is it?
#
# Every detection of this tour got an identity at once, but not all are equally certain. `confidence`
# is the probability that the identity is the right one; over many answers it is about the share that
# is right. The answers of a run wait 20 frames (`delay`); at once, as live, they are less certain. The
# least certain one:

# %%
at_once = rj.run(tour.frames, image_fps=options.fps, delay=0)
answers = [
    (float(tracks.confidence[row]), tracks.frame_index, row)
    for tracks in at_once.tracks
    for row in range(len(tracks))
]
confidence, frame, row = min(answers)
tracks = at_once.tracks[frame]
known = tracks.candidate_id[row] >= 0
names = [f"{tracks.labels[row]} {i}" for i in tracks.candidate_id[row][known]]
chances = tracks.candidate_score[row][known]
names, chances = [*names, "a new object"], [*chances, 1 - sum(chances)]

figure, bars = plt.subplots(figsize=(6, 1.8))
bars.barh(names, chances, color="#0072B2")
bars.bar_label(bars.containers[0], fmt="%.2f", padding=3)
bars.set(xlim=(0, 1), xlabel="probability of the candidate", title="what it could be")
bars.invert_yaxis()
plt.show()
print(f"frame {frame}: {tracks.display_name(row)}, confidence {confidence:.2f}")
show(draw_overlay(tour.frames[frame].image, tracks))

# %% [markdown]
# The camera comes back, it is dark, and a box comes into view. There are two boxes that look the same: it
# could be either of them, or a third one that was never in view. *box 2* is right, and hardly likelier than
# a new one.
#
# Where no answer is more likely than not, none is given: the detection is undecided and names
# its candidates. When the evidence suffices, it becomes one of them.
#
# | outcome | meaning | shown as |
# | --- | --- | --- |
# | `match`, `new` | *firm*: a known object, or the first sight of one | `mug 3` |
# | `ambiguous` | one of two or three known objects | `mug 3 or 7?` |
# | `provisional_parent` | probably this known object, not certainly | `mug 3?` |
# | `provisional_new` | probably new, a known one cannot be excluded | `mug new?` |
#
# The paper's tracker (`config="remind"`) is undecided far more often: notebook 02 shows one such
# decision. What to do about an undecided detection depends on your program: a map may wait (a recorded
# run waits 20 frames; `delay=` sets how many), a gripper may look again from
# another viewpoint.

# %%
outcomes = [Counter(rj.Outcome(code).name.lower() for code in t.outcome) for t in result.tracks]
shades = {
    "match": "#0072B2",
    "new": "#56B4E9",
    "ambiguous": "#E69F00",
    "provisional_parent": "#D55E00",
    "provisional_new": "#CC79A7",
}
figure, axes = plt.subplots(figsize=(10, 2.4))
bottom = np.zeros(len(outcomes))
for outcome, color in shades.items():
    counts = np.array([count[outcome] for count in outcomes])
    axes.bar(np.arange(len(outcomes)), counts, 0.9, bottom, color=color, label=outcome)
    bottom += counts
axes.axvspan(left - 0.5, back - 0.5, color="0.9", zorder=0)
axes.text((left + back) / 2, bottom.max() + 0.2, "in the other room", ha="center")
axes.set(xlabel="frame", ylabel="detections", ylim=(0, bottom.max() + 1))
axes.legend(ncols=5, loc="upper center", bbox_to_anchor=(0.5, -0.25), frameon=False)
plt.show()

# %% [markdown]
# ## Was it right?
#
# The truth is known here, so the run can be scored. The same function scores runs on your annotated
# masks; `remind eval` does it for files of any tracker.

# %%
from remind_jax.metrics import evaluate_tracks

scores = evaluate_tracks(result.tracks, name="tour").scores()
meaning = {
    "IDF1": "each object has one right id for the whole video",
    "Recovery": "returns after which an object got its identity back",
    "FirmShare": "detections with an identity",
    "FirmAccuracy": "of these, identities that belong to the object",
}
lines = [f"| {name} | {scores[name]:.3f} | {text} |" for name, text in meaning.items()]
Markdown("\n".join(["| score | value | meaning |", "| --- | ---: | --- |", *lines]))

# %% [markdown]
# Everything has its own identity again, in less light and from another side, the boxes that look alike as
# well. Does the confidence tell how sure that was? Of answers that it doubts fewer should be right, over
# many tours; on one as short as this all are.

# %%
right_id = {}  # the identity that an object had first
right, confidences = [], []
for tracks, frame in zip(result.tracks, tour.frames):
    for row, instance in enumerate(frame.detections.instance_ids.tolist()):
        object_id = int(tracks.object_id[row])
        right.append(right_id.setdefault(instance, object_id) == object_id)
        confidences.append(float(tracks.confidence[row]))
right, confidences = np.array(right), np.array(confidences)
for low, high in ((0.0, 0.75), (0.75, 1.01)):
    chosen = (confidences >= low) & (confidences < high)
    print(
        f"confidence {low:.2f} to {min(high, 1):.2f}: {right[chosen].sum()} of {chosen.sum()} right"
    )

# %% [markdown]
# Notebook 03 shows how thresholds are chosen.
#
# ## Save the memory, continue later
#
# A run writes its memory, and another run can continue from it. Cut in the middle, the tour gets the
# same identities as in one piece.

# %%
rj.run(tour.frames[:35], out=work / "morning", overlay=False, overwrite=True)
evening = rj.run(tour.frames[35:], memory=work / "morning" / "memory.safetensors")

same = all(
    np.array_equal(a.object_id, b.object_id)
    for a, b in zip(evening.tracks, result.tracks[35:], strict=True)
)
print("same identities as in one run:", same)
print(
    "size of the memory file:", (work / "morning/memory.safetensors").stat().st_size // 1000, "kB"
)

# %% [markdown]
# In a live loop the same tracker takes one frame at a time, without files and threads:

# %%
tracker = rj.Tracker()
tracker.load(work / "morning" / "memory.safetensors")
image, masks = tour.frames[46].image, tour.frames[46].detections
tracks = tracker.update(image, masks)
print([tracks.display_name(row) for row in range(len(tracks))])
tracker.save(work / "tonight.safetensors")

# %% [markdown]
# ## The output folder
#
# `report.html` is one page with everything: a video with a timeline that seeks it, the gallery, settings
# and times.

# %%
for path in sorted((work / "tour").iterdir()):
    print(f"{path.name:22s} {path.stat().st_size / 1000:8.0f} kB")

# %% [markdown]
# ## Your own video
#
# ```bash
# remind run rooms.mp4 --detector yolo11n-seg.onnx --classes chair cup
# remind run frames/ --masks masks/
# ```
#
# or `rj.run("rooms.mp4", detector="yolo11n-seg.onnx", out="runs/rooms")`.
#
# **Take-away.** One call gives every detection an identity with its probability, or a short list of what
# it could be. Use answers that are certain enough for you; otherwise wait, look again from another
# viewpoint, or decide by a rule of your own.
