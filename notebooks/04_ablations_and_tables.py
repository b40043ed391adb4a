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
# # 04 Ablations and tables
#
# What does each part of a method contribute, and how good are simpler trackers? You learn
#
# * to run the default, which is REMIND plus, the paper's tracker, ablations of both, and baselines on
#   the same masks and features;
# * to compare them in one table, with intervals, and to save it for a paper;
# * why the paper's numbers and the standard definitions of the same names differ;
# * to do the same on your own data in the DAVIS layout.
#
# Two short rendered scenes are used in place of your data. They are far too small to rank anything: note
# the intervals.

# %%
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Markdown

import remind_jax as rj
from remind_jax.synthetic import LookalikeGroup, SceneOptions, make_scene, write_davis

plt.rcParams.update({"figure.dpi": 80, "axes.spines.top": False, "axes.spines.right": False})
work = Path(tempfile.mkdtemp())

# %% [markdown]
# ## Data in the DAVIS layout
#
# `JPEGImages/SCENE/*.jpg`, `Annotations/SCENE/*.png` with one value per instance, and `metadata.json`
# that names the class of each. With your own folder, set `root` to it and leave this cell out.

# %%
root = work / "DAVIS"
scenes = []
for seed in (4, 7):
    options = SceneOptions(
        name=f"tour_{seed}", seed=seed, width=480, height=352, frames=48, absence_frames=16,
        objects_per_room=7, light_drop=0.3, min_mask_px=300,
        lookalikes=(LookalikeGroup("mug", 3, "glaze"), LookalikeGroup("box", 2, "identical")),
    )  # fmt: skip
    write_davis(make_scene(options), root)
    shutil.move(root / "metadata.json", root / "Annotations" / options.name / "metadata.json")
    scenes.append(options.name)
print(sorted(str(path.relative_to(root)) for path in root.glob("*/*")))

# %% [markdown]
# ## Methods
#
# Configurations by name, and other trackers by name. All use the same masks and the same features.

# %%
from remind_jax.benchmark.contenders import make_contenders
from remind_jax.config import list_configs

contenders = {contender.name: contender.config for contender in make_contenders()}
print(", ".join(contenders))

# %% [markdown]
# | name | what it is |
# | --- | --- |
# | `default` | REMIND plus, our method on the same inputs: tracklets get identities; place and layout are evidence |
# | `published` | the paper's tracker with every threshold as published, for DINOv3 features |
# | `remind` | the same with thresholds that fit the weight-free features used here |
# | `ablation_plus_*` | `default` with one part removed |
# | `ablation_*`, the others | `remind` with one part removed |
# | `bank`, `running-mean`, `momentum` | trackers by appearance alone |
# | `iou` | overlap with the last frame, no appearance |

# %%
for name, config in contenders.items():
    for scene in scenes:
        rj.run(root, sequence=scene, config=config, out=work / "runs" / name / scene, overlay=False)
print(len(contenders), "trackers on", len(scenes), "scenes")

# %% [markdown]
# ## One table
#
# Scores are the standard ones, equal to TrackEval's. Ranges are 95 % bootstrap intervals over scenes; with
# two scenes they only show how different these two are.

# %%
predictions = {name: work / "runs" / name for name in contenders}
table = rj.compare(root, predictions)
shown = replace(table, columns=("HOTA", "IDF1", "Recovery", "IDSW", "IDs", "GT_IDs"))
Markdown(shown.to_markdown())

# %%
names = [row.name for row in table.rows]
figure, all_axes = plt.subplots(1, 3, figsize=(12, 4.2), sharey=True)
for axis, metric in zip(all_axes, ("IDF1", "Recovery", "AmbiguousShare")):
    for place, row in enumerate(table.rows):
        score = 100 * row.scores.get(metric, np.nan)
        color = "#0072B2" if row.name in list_configs() else "#E69F00"
        if metric in row.intervals:
            low, high = row.intervals[metric]
            axis.plot([100 * low, 100 * high], [place, place], color=color, linewidth=2)
        axis.scatter(score, place, color=color, zorder=2)
    axis.set(xlabel=f"{metric}, %", xlim=(-4, 104))
    axis.grid(axis="x", alpha=0.3)
all_axes[0].set_yticks(range(len(names)), names)
all_axes[0].invert_yaxis()
figure.suptitle("blue: REMIND and plus, orange: baselines; lines: 95 % over scenes")
figure.tight_layout()
plt.show()

# %% [markdown]
# IDF1 counts every undecided detection as a miss. That lowers the score of a tracker that leaves
# detections undecided, as the paper's does (on these two scenes about one in a hundred, with published
# thresholds), and not of the baselines, which always answer. How often each is right when it does answer:

# %%
undecided = replace(
    table, columns=("FirmShare", "FirmAccuracy", "AmbiguousShare", "CandidateHitRate"), legend=()
)
Markdown(undecided.to_markdown())

# %% [markdown]
# The same tables can be saved for a paper:

# %%
for ending in ("csv", "md"):
    table.save(work / f"comparison.{ending}")

# %% [markdown]
# ## The paper's numbers
#
# The published numbers use definitions of their own: any overlap above zero is a match, undecided
# detections are collapsed to one id before scoring, the first frame of an object counts as wrong, and
# false positives of other trackers are not counted. `--protocol paper` computes them as the original
# evaluator does. Beside the standard ones:

# %%
from remind_jax.metrics.paper_evaluation import evaluate_paper

lines = ["| tracker | IDF1, standard | IDF1, paper | Recovery, standard | Recovery, paper |",
         "| --- | ---: | ---: | ---: | ---: |"]  # fmt: skip
for row in table.rows:
    is_remind = row.name in list_configs()  # REMIND's formulas, or those for all other trackers
    scored = evaluate_paper(root, predictions[row.name], name=row.name)[
        0 if is_remind else 1
    ].scores()
    values = [row.scores["IDF1"], scored["IDF1"], row.scores["Recovery"], scored["Recovery"]]
    lines.append(f"| {row.name} | " + " | ".join(f"{100 * value:.1f}" for value in values) + " |")
Markdown("\n".join(lines))

# %% [markdown]
# Do not compare a number of one column with a number of another one: the same run has all of them. Every
# deviation is listed under the table of `remind eval GT RUN --protocol paper`, and in
# [Evaluation](../docs/evaluation.md).
#
# ## On your data
#
# One command does all of this for a data set, keeps finished results, and writes the tables:
#
# ```bash
# remind benchmark DAVIS_ROOT                          # all contenders, true masks
# remind benchmark DAVIS_ROOT --detector yolo.onnx     # masks of a detector
# remind benchmark DAVIS_ROOT --methods default remind bank --scenes kitchen
# remind eval DAVIS_ROOT ours sam masa --table comparison.md   # results of other programs
# ```
#
# Results on twelve rendered tours are in [Benchmark](../docs/benchmark.md).
#
# **Take-away.** Compare on the same masks, features and definitions; show intervals, and say how undecided
# detections were counted. On as few scenes as here, differences of some points mean nothing.
