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
# # 03 Sweep and pick thresholds
#
# Thresholds are traced numbers: many settings on many scenes are one compiled program, scored on the
# device. You learn
#
# * to sweep a grid and to read it as a heat map;
# * to choose between right answers and undecided ones on a Pareto front;
# * which thresholds matter at all, and to let Optuna search;
# * to find out, by cross-validation, whether a choice holds on scenes that it has not seen.
#
# The thresholds are those of the default tracker, REMIND plus; with `config="remind"` everything works
# the same on the thresholds of the paper's tracker. Scenes need masks whose objects are known. Here
# three small tours with many look-alikes are rendered.

# %%
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Markdown

import remind_jax as rj
from remind_jax.synthetic import LookalikeGroup, SceneOptions, render_sequence

plt.rcParams.update({"figure.dpi": 80, "axes.spines.top": False, "axes.spines.right": False})
BLUE, ORANGE, GREEN, GRAY = "#0072B2", "#E69F00", "#009E73", "0.7"

scenes = [
    render_sequence(
        SceneOptions(
            name=f"tour {seed}", seed=seed, width=320, height=240, frames=48, absence_frames=16,
            objects_per_room=8, light_drop=0.3, min_mask_px=150,
            classes=("mug", "box", "vase", "bottle"),
            lookalikes=(LookalikeGroup("mug", 3, "glaze"), LookalikeGroup("box", 2, "identical")),
        )
    ).frames
    for seed in (2, 4, 7)
]  # fmt: skip
print(", ".join(f"{len(frames)} frames" for frames in scenes))

# %% [markdown]
# ## A grid
#
# A `SceneBench` reads and describes scenes once, for sweep after sweep. With a single sweep,
# `rj.sweep(scenes, {"decision.new": [...], ...})` is all that is needed. Names and meaning of all
# thresholds: [every setting](../docs/thresholds.md).
#
# This grid has two thresholds: `decision.new`, the log odds of a new object before any evidence, and
# `decision.firm`, the least probability of an answer that is given before its tracklet is decided. Less
# probable answers stay undecided.

# %%
bench = rj.sweeps.SceneBench(scenes, config="default", batch=8)

new = [-0.5, 0.25, 1.0, 1.75, 2.5]
firm = [0.5, 0.6, 0.7, 0.8]
settings = rj.sweeps.grid({"decision.new": new, "decision.firm": firm})

found = bench.run([{}, *settings])  # {}: the configuration as it stands
frames = len(found.settings) * sum(len(scene) for scene in scenes)
print(f"{len(found.settings)} settings x {len(found.scenes)} scenes, {frames} settings x frames")

# %% [markdown]
# Every row has the scores of the run with that setting; a test of the repository checks it. The best by
# mean IDF1:

# %%
Markdown(found.to_markdown(found.best("IDF1", 5)))

# %%
scores = {
    metric: np.array([s.scores[metric] for s in found.standings()[1:]]) for metric in found.metrics
}
shape = (len(new), len(firm))

figure, all_axes = plt.subplots(1, 3, figsize=(12, 3.6))
shown = {"IDF1": "cividis", "Recovery": "cividis", "Firm": "cividis"}
for axis, (metric, colors) in zip(all_axes, shown.items()):
    values = 100 * scores[metric].reshape(shape)
    axis.imshow(values, cmap=colors, aspect="auto", origin="lower")
    middle = (values.min() + values.max()) / 2
    for row in range(shape[0]):
        for column in range(shape[1]):
            is_dark = values[row, column] < middle
            axis.text(column, row, f"{values[row, column]:.1f}", ha="center", va="center",
                      color="white" if is_dark else "black")  # fmt: skip
    axis.set_xticks(range(len(firm)), firm)
    axis.set_yticks(range(len(new)), new)
    axis.set(xlabel="decision.firm", title=f"{metric}, % (mean of {len(scenes)} scenes)")
all_axes[0].set_ylabel("decision.new")
figure.tight_layout()
plt.show()

# %% [markdown]
# ## Right answers against undecided ones
#
# The share of undecided detections is not an error rate: it is the cost of being careful. No other
# setting is better in both scores than one on the *Pareto front*; which of these is best depends on your
# use. Here the front is short: beyond a few undecided detections, more of them do not make better answers.

# %%
front = found.pareto("IDF1", "Firm")
given = found.standings()[0].scores
figure, axis = plt.subplots(figsize=(6.5, 4))
axis.scatter(
    100 * (1 - scores["Firm"]), 100 * scores["IDF1"], color=GRAY, label="settings of the grid"
)
ends = [(100 * (1 - s.scores["Firm"]), 100 * s.scores["IDF1"]) for s in front]
axis.plot(*zip(*sorted(ends)), color=BLUE, marker="o", label="Pareto front")
axis.scatter(100 * (1 - given["Firm"]), 100 * given["IDF1"], color=ORANGE, marker="*", s=180,
             label="default", zorder=3)  # fmt: skip
axis.set(xlabel="undecided detections, %", ylabel="IDF1, %")
axis.legend(frameon=False)
plt.show()
for standing in front:
    values = (
        ", ".join(f"{name} = {value:g}" for name, value in standing.setting.items()) or "default"
    )
    print(
        f"IDF1 {standing.scores['IDF1']:.1%}, firm {standing.scores['Firm']:.1%}: {values}"
    )

# %% [markdown]
# ## Which thresholds matter?
#
# Each threshold moves through its range while all others stay. Most hardly matter; knowing which do
# shortens a search. (`rj.sweeps.PLUS_SPACE` has sensible ranges of more of them, `PAPER_SPACE` those of the
# paper's tracker.)

# %%
space = {
    "decision.new": (-0.5, 3.0),
    "decision.firm": (0.3, 0.8),
    "looks.gain": (0.3, 1.5),
    "layout.weight": (0.0, 1.6),
    "place.weight": (0.0, 1.6),
}
curves, _ = rj.sweeps.move_one_at_a_time(bench, space, number=3)

figure, axis = plt.subplots(figsize=(8, 3))
for place, curve in enumerate(curves):
    values = 100 * np.array([*curve.scores, curve.given_score])
    axis.plot(
        [values.min(), values.max()], [place, place], color=GRAY, linewidth=6, solid_capstyle="butt"
    )
    for value, score in zip(curve.values, curve.scores):
        axis.scatter(100 * score, place, color=BLUE, zorder=2)
        axis.annotate(f"{value:g}", (100 * score, place), (0, 7), textcoords="offset points",
                      ha="center", fontsize=8)  # fmt: skip
axis.axvline(100 * curves[0].given_score, color=ORANGE, linestyle="--", label="default")
axis.set_yticks(range(len(curves)), [curve.name for curve in curves])
axis.set(xlabel="IDF1, % (mean of the scenes); small numbers: value of the threshold")
axis.invert_yaxis()
axis.margins(y=0.15)
axis.legend(frameon=False, loc="lower left")
plt.show()

# %% [markdown]
# ## Search
#
# Optuna proposes settings in batches; each batch is one call of the compiled program. With two
# objectives it searches for the front itself. Known rows are not computed again.

# %%
tuned = rj.sweeps.search(
    bench,
    {
        name: space[name]
        for name in ("decision.new", "decision.firm", "looks.gain")
    },
    number=16,
    at_once=8,
    sampler="tpe",
    objectives=("IDF1", "Firm"),
)
figure, axis = plt.subplots(figsize=(6.5, 4))
for label, result, color in (("grid", found, GRAY), ("search", tuned, BLUE)):
    points = [(100 * (1 - s.scores["Firm"]), 100 * s.scores["IDF1"]) for s in result.standings()[1:]]
    axis.scatter(*zip(*points), color=color, label=f"{label}, {len(points)} settings")
axis.scatter(
    100 * (1 - given["Firm"]), 100 * given["IDF1"], color=ORANGE, marker="*", s=180, label="default"
)
axis.set(xlabel="undecided detections, %", ylabel="IDF1, %")
axis.legend(frameon=False)
plt.show()

# %% [markdown]
# ## Does it hold elsewhere?
#
# The best of many settings on a few scenes is partly chance. Cross-validation shows how much: a setting
# is chosen on all scenes but one, and scored on that one.

# %%
checked = rj.sweeps.cross_validate(found, "IDF1")
Markdown(checked.to_markdown())

# %%
place = np.arange(len(checked.folds))
figure, axis = plt.subplots(figsize=(7, 3))
columns = {
    "default": ([fold.given_score for fold in checked.folds], ORANGE),
    "chosen on the other scenes": ([fold.score for fold in checked.folds], BLUE),
    "best for this scene, chosen on it": (
        np.nanmax(found.table()[:, :, found.metrics.index("IDF1")], axis=0), GRAY,
    ),
}  # fmt: skip
for offset, (label, (values, color)) in zip((-0.27, 0, 0.27), columns.items()):
    bars = axis.bar(place + offset, 100 * np.asarray(values), 0.25, color=color, label=label)
    axis.bar_label(bars, fmt="%.1f", padding=2, fontsize=8)
axis.set_xticks(place, [f"scene {n}" for n in range(len(place))])
axis.set(ylabel="IDF1, %", ylim=(0, 115))
axis.legend(frameon=False, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.12), fontsize=9)
plt.show()
low, high = checked.interval(checked.gains)
print(
    f"gain over the default on unseen scenes: {checked.gains.mean():+.3f} [{low:+.3f}, {high:+.3f}]"
)

# %% [markdown]
# The gray bars are what tuning on the test scene would claim; the blue ones are what to expect. Where
# the interval of the gain contains zero, the data do not show that tuning helps, and the default is
# the better choice. Here it contains zero. Three short tours of one renderer are too few
# for tuning. To tune on your own data take ten scenes or more from your rooms and your camera,
# keep some of them aside, and vary few thresholds.
#
# ## On the command line
#
# ```bash
# remind sweep kitchen/ office/ --set decision.new=0:2:0.5 decision.firm=0.5,0.7 --out sweeps/first
# remind sweep kitchen/ office/ --set decision.new=0,2 looks.gain=0.4,1.2 --search tpe
# ```
#
# Rows are stored as they are computed, so that an interrupted sweep continues where it stopped;
# `--workers` and `--cluster` distribute it over processes and machines.
#
# **Take-away.** Sweeps are cheap, so look at the whole range of settings. Choose on the front of the
# scores that you need, and believe only what holds on scenes that were not used for choosing.
