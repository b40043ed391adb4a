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
# # 02 Inside one decision
#
# Two boxes look exactly the same. In one frame the paper's tracker still tells them apart. You learn
#
# * to get the reasons of any decision, in words and numbers;
# * how the visual channels add up, and when context is used;
# * what the memory contains: banks of prototypes, which objects are seen together, and how far apart;
# * how layout decides where appearance cannot.
#
# The video is a tour like that of notebook 01, rendered here. The tracker is that of the paper,
# `config="remind"`. The default decides by other evidence; the same calls explain it
# ([Explain](../docs/explain.md)).

# %%
import io
import tempfile
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image

import remind_jax as rj
from remind_jax.outputs.overlay import draw_overlay
from remind_jax.remind.stages import MatchOrigin
from remind_jax.synthetic import LookalikeGroup, SceneOptions, render_sequence

plt.rcParams.update({"figure.dpi": 80, "axes.spines.top": False, "axes.spines.right": False})
BLUE, ORANGE, GREEN, PINK, GRAY = "#0072B2", "#E69F00", "#009E73", "#CC79A7", "0.6"
work = Path(tempfile.mkdtemp())

options = SceneOptions(
    name="tour", seed=12, width=480, height=352, frames=60, absence_frames=20, objects_per_room=7,
    lookalikes=(LookalikeGroup("mug", 3, "glaze"), LookalikeGroup("box", 2, "identical")),
    light_drop=0.3, min_mask_px=300,
)  # fmt: skip
tour = render_sequence(options)

# %% [markdown]
# ## Record a trace
#
# `trace=True` records the evidence of every decision (about 3 kB per frame). On the command line:
# `remind run ... --trace`, then `remind explain RUN --frame 46`.

# %%
# The thresholds of the paper's tracker, with those that fit the default features.
config = rj.load_config("remind").for_backbone("patch-statistics")
result = rj.run(tour.frames, config=config, trace=True)

# %% [markdown]
# ## Find an interesting decision
#
# Every detection can be explained. We look for a match that the layout of the scene decided, and take
# the first one; without one, the least confident match.

# %%
explanations = [
    result.explain(tracks.frame_index, row)
    for tracks in result.tracks
    for row in np.flatnonzero(tracks.outcome == rj.Outcome.MATCH)
]
by_layout = [one for one in explanations if one.source not in (MatchOrigin.NONE, MatchOrigin.ASSOCIATION)]
explanation = by_layout[0] if by_layout else min(explanations, key=lambda one: one.confidence)
print(len(explanations), "matches,", len(by_layout), "decided by layout")
print(f"frame {explanation.frame}, detection {explanation.detection}: {explanation.name}")

# %%
tracks = result.tracks[explanation.frame]
likeliest = [candidate for candidate in explanation.candidates if candidate.plausible][:2]


def crop(frame, row, margin_px=12):
    """The detection, cut out of its frame."""
    left, top, right, bottom = result.tracks[frame].boxes[row].astype(int)
    image = tour.frames[frame].image
    return image[
        max(0, top - margin_px) : bottom + margin_px, max(0, left - margin_px) : right + margin_px
    ]


def first_sight(object_id):
    """Frame and row in which an object was seen first."""
    for tracks in result.tracks:
        rows = np.flatnonzero(tracks.object_id == object_id)
        if len(rows):
            return tracks.frame_index, rows[0]


def photo(figure):
    """A figure of pictures as a small JPEG."""
    data = io.BytesIO()
    figure.savefig(data, format="jpeg", bbox_inches="tight", dpi=90, pil_kwargs={"quality": 80})
    plt.close(figure)
    return Image(data.getvalue(), format="jpeg")


figure, axes = plt.subplots(1, 4, figsize=(12, 3.4), width_ratios=(2.6, 1, 1, 1))
axes[0].imshow(draw_overlay(tour.frames[explanation.frame].image, tracks))
axes[0].set_title(f"frame {explanation.frame}")
axes[1].imshow(crop(explanation.frame, explanation.detection))
axes[1].set_title(f"detection {explanation.detection}")
for axis, candidate in zip(axes[2:], likeliest):
    frame, row = first_sight(candidate.object_id)
    axis.imshow(crop(frame, row))
    axis.set_title(f"{candidate.name}\nin frame {frame}")
for axis in axes:
    axis.set_axis_off()
figure.tight_layout()
photo(figure)

# %% [markdown]
# ## The reasons in words
#
# The sentences follow the tracker: which objects the detection resembles, what context adds, the joint
# assignment, the guards, and the outcome. Thresholds stand beside the numbers.

# %%
for number, sentence in enumerate(explanation.why, start=1):
    print(f"{number}. {sentence}")

# %% [markdown]
# `print(explanation)` adds the tables of candidates, sets and layout; `explanation.to_json()` is the same
# for programs.
#
# ## How the scores come about
#
# The visual score is the weighted mean of the channels: the object itself, its background, its
# parts. A channel's weight falls with the quality of the observation, and a channel that is missing
# on either side does not count. Context may add or take a little.

# %%
threshold = config.thresholds.matching.match
figure, axis = plt.subplots(figsize=(9, 0.6 + 0.65 * len(explanation.candidates)))
channels = {"object": BLUE, "background": GREEN, "parts": ORANGE}
for place, candidate in enumerate(explanation.candidates):
    terms = {
        name: candidate.terms[name] for name in channels if candidate.terms[name].score is not None
    }
    weights = sum(term.weight for term in terms.values())
    left = 0.0
    for name, term in terms.items():
        width = term.score * term.weight / weights
        axis.barh(place, width, left=left, color=channels[name], edgecolor="white")
        label = f"{term.score:.2f} x {term.weight / weights:.2f}"
        axis.text(
            left + width / 2, place, label, ha="center", va="center", color="white", fontsize=9
        )
        left += width
    axis.text(left + 0.01, place, f"{candidate.visual_score:.3f}", va="center")
axis.axvline(threshold, color="black", linestyle="--", linewidth=1)
axis.text(threshold, -0.75, f"match threshold {threshold:.2f}", ha="center", fontsize=9)
axis.set_yticks(range(len(explanation.candidates)), [c.name for c in explanation.candidates])
axis.set(
    xlim=(0, 1.1),
    ylim=(len(explanation.candidates) - 0.5, -0.9),
    xlabel="visual score: cosine x share of the weight",
)
handles = [plt.Rectangle((0, 0), 1, 1, color=color) for color in channels.values()]
axis.legend(
    handles, list(channels), ncols=3, frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.4)
)
plt.show()

# %% [markdown]
# Both boxes pass the threshold by far, and their scores are close to each other: by appearance alone
# this detection stays `AMBIGUOUS`.
#
# ## The memory before that frame
#
# A run writes its memory as a file; a tracker that loads it shows it as a tree of arrays
# (`remind_jax.remind.state.TrackerState`). We stop a run right before the frame.

# %%
earlier = tour.frames[: explanation.frame]
rj.run(earlier, config=config, trace=True, out=work / "before", overlay=False, overwrite=True)
tracker = rj.Tracker("remind")
tracker.load(work / "before" / "memory.safetensors")
memory = jax.device_get(tracker.state)

ids = [int(i) for i in memory.objects.id if i >= 0]
labels = {history.object_id: history.label for history in result.objects()}
names = [f"{labels[i]} {i}" for i in ids]
asked = [ids.index(candidate.object_id) for candidate in likeliest]
print(len(ids), "objects:", ", ".join(names))

# %% [markdown]
# ### Two banks per channel
#
# New views enter the *work* bank. Prototypes that were confirmed often enough, in good quality, are
# promoted to the *stable* bank, which changes slowly. Scores read the stable bank first.

# %%
channels = {
    "appearance": memory.appearance,
    "parts": memory.parts,
    "rings (background)": memory.rings,
}
figure, all_axes = plt.subplots(1, 3, figsize=(11, 3.6), sharey=True)
for axis, (title, banks) in zip(all_axes, channels.items()):
    work_size = banks.work.size[:, : len(ids)].sum(axis=0)
    stable_size = banks.stable.size[:, : len(ids)].sum(axis=0)
    axis.barh(names, work_size, color=ORANGE, label="work")
    axis.barh(names, stable_size, left=work_size, color=BLUE, label="stable")
    axis.set(title=title, xlabel="prototypes (all channels)")
all_axes[0].invert_yaxis()
all_axes[-1].legend(frameon=False)
figure.tight_layout()
plt.show()

# %% [markdown]
# How similar are the two candidates? Cosines between all their appearance prototypes:

# %%
blocks, owners = [], []
for slot in asked:
    for kind, bank in (("work", memory.appearance.work), ("stable", memory.appearance.stable)):
        kept = bank.embedding[0, slot, : bank.size[0, slot]]
        blocks.append(kept)
        owners += [f"{names[slot]}, {kind} {n}" for n in range(len(kept))]
prototypes = np.concatenate(blocks)
cosine = prototypes @ prototypes.T

figure, axis = plt.subplots(figsize=(1.6 + 0.42 * len(prototypes), 1.2 + 0.42 * len(prototypes)))
picture = axis.imshow(cosine, vmin=0.3, vmax=1, cmap="Blues")
axis.set_xticks(range(len(prototypes)), owners, rotation=90)
axis.set_yticks(range(len(prototypes)), owners)
for row, column in np.ndindex(cosine.shape):
    ink = "white" if cosine[row, column] > 0.7 else "black"
    axis.text(
        column, row, f"{cosine[row, column]:.2f}", ha="center", va="center", color=ink, fontsize=9
    )
axis.set_title("global descriptors")
figure.colorbar(picture, label="cosine", shrink=0.8)
axis.spines[:].set_visible(False)
plt.show()

# %% [markdown]
# ### Two graphs of neighbors
#
# The first graph counts *episodes* in which two objects were seen together; a new episode begins when
# the objects in view change, or after some frames. The second keeps how far apart they were, in units of
# object size. Objects of one room form a group; two objects that were never in view together have no
# line.

# %%
num = len(ids)
together = memory.cooccurrence.count[:num, :num]
apart = np.asarray(memory.distances.edges.gap_mean)[:num, :num]
measured = np.asarray(memory.distances.edges.count)[:num, :num] > 0
angle = 2 * np.pi * np.arange(num) / num
x, y = np.sin(angle), np.cos(angle)
colors = plt.get_cmap("viridis_r")
furthest = apart[measured].max()

figure, (left, right, beside) = plt.subplots(1, 3, figsize=(12, 4.6), width_ratios=(1, 1, 0.03))
for a, b in zip(*np.triu_indices(num, 1)):
    ends = {"xdata": x[[a, b]], "ydata": y[[a, b]], "zorder": 1}
    count = max(together[a, b], together[b, a])
    if count:
        asked_one = a in asked or b in asked
        left.add_line(plt.Line2D(**ends, color=BLUE if asked_one else GRAY, linewidth=0.9 * count))
    if measured[a, b] or measured[b, a]:
        distance = apart[a, b] if measured[a, b] else apart[b, a]
        right.add_line(plt.Line2D(**ends, color=colors(distance / furthest), linewidth=2))
for axis in (left, right):
    axis.scatter(
        x, y, s=60, color=[ORANGE if i in asked else "black" for i in range(num)], zorder=2
    )
    for place, name in enumerate(names):
        side = "left" if x[place] > 0.1 else "right" if x[place] < -0.1 else "center"
        axis.annotate(name, (1.12 * x[place], 1.12 * y[place]), va="center", ha=side)
    axis.set(xlim=(-1.8, 1.8), ylim=(-1.25, 1.25), aspect="equal")
    axis.set_axis_off()
left.set_title("seen together: width = episodes, blue: of the candidates")
right.set_title("how far apart")
scale = plt.cm.ScalarMappable(plt.Normalize(0, furthest), colors)
figure.colorbar(scale, cax=beside, label="mean distance, object sizes")
plt.show()

# %% [markdown]
# ### Context: sets of objects
#
# From the first graph the tracker builds sets of objects that may be in view together. In this frame
# they are not mature enough to change a score:

# %%
print(f"context used: {explanation.context.usable}, quality {explanation.context.quality:.2f}")
for found in explanation.sets[:4]:
    print(f"{found.score:.2f}  {', '.join(found.names)}")

# %% [markdown]
# ### Layout: which one is nearer
#
# The second graph is used only when a closed group of look-alikes stays undecided: as many detections as
# known objects. Objects whose distances told them apart before vote.

# %%
settled = [known for known in explanation.known_sets if known.voters]
if settled:
    vote = settled[-1]
    voter = vote.voters[0]
    others = [row for row in vote.detections if row != explanation.detection]
    now = {explanation.detection: voter.distance}
    for row in others:
        other = result.explain(explanation.frame, row).known_sets[-1]
        now[row] = other.voters[0].distance

    figure, axis = plt.subplots(figsize=(9, 2.6))
    for object_id, usual in voter.remembered.items():
        name = f"{labels[object_id]} {object_id}"
        axis.scatter(usual, 1, s=110, color=ORANGE, zorder=2)
        axis.annotate(name, (usual, 1), (0, 10), textcoords="offset points", ha="center")
    for row, distance in now.items():
        axis.scatter(distance, 0, s=110, color=BLUE, marker="s", zorder=2)
        axis.annotate(
            f"detection {row}", (distance, 0), (0, -18), textcoords="offset points", ha="center"
        )
    axis.set_yticks([1, 0], ["remembered", "in this frame"])
    axis.set(ylim=(-0.7, 1.6), xlim=(0, 1.15 * max(*now.values(), *voter.remembered.values())))
    axis.set_xlabel(f"distance to {voter.name}, in object sizes")
    axis.grid(axis="x", alpha=0.3)
    figure.tight_layout()
    plt.show()
    print(
        f"{vote.status.name.lower()}: score {vote.score:.2f}, the other way round {vote.second or 0:.2f}"
    )

# %% [markdown]
# One box has always been nearer to it than the other, and one detection is nearer now. That order
# settles both detections.
#
# ## Was it right?
#
# The renderer knows the instance ids: does the first detection of the object have the same one?

# %%
for row in settled[-1].detections if settled else (explanation.detection,):
    object_id = int(tracks.object_id[row])
    frame, first_row = first_sight(object_id)
    truth, then = tracks.instance_ids[row], result.tracks[frame].instance_ids[first_row]
    verdict = "right" if truth == then else "wrong"
    print(
        f"detection {row}: {tracks.display_name(row)} is instance {truth}, "
        f"at its first sight it was {then}: {verdict}"
    )

# %% [markdown]
# **Take-away.** Every decision can be taken apart: appearance scores the candidates, the joint assignment
# chooses, guards withdraw what could as well be swapped, layout decides what it can, and the rest stays
# undecided. `remind explain` gives the same for any run that was made with `--trace`, and in
# `report.html` a click on a detection opens it.
