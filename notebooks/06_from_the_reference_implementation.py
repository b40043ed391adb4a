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
# # 06 From the reference implementation to this one
#
# You know or have used
# [remind-reid-tracker](https://github.com/cvar-vision-dl/remind-reid-tracker). You learn
#
# * how to import a configuration file of the original, and which of its keys are translated, have no
#   effect, or are refused;
# * how to check that both trackers decide the same, on traces recorded from the original;
# * where the paper and its code differ, and which setting gives the paper's rule.
#
# This is about the paper's tracker, `published`. The default here is another one, REMIND plus, on the
# same inputs ([what it does](../docs/plus.md)): an imported file runs the paper's tracker, and
# `rj.run(...)` without a configuration does not.
#
# The notebook needs a clone of the repository: the recorded traces are in `tests/golden`.

# %%
import collections
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
from IPython.display import Markdown

import remind_jax as rj

plt.rcParams.update({"figure.dpi": 80, "axes.spines.top": False, "axes.spines.right": False})
work = Path(tempfile.mkdtemp())

# %% [markdown]
# ## Import a configuration
#
# A file of the original may contain any of its keys; keys that it leaves out keep the value that the
# original ships.

# %%
theirs = """
runtime: {device: cuda}          # where it runs
association:
  matching:
    match_thr: 0.72              # a plain number
    object_mode: global          # a choice
update:
  remove_enabled: true           # a switch
memory:
  appearance:
    max_prototypes_per_channel: 30   # one of a pair of capacities
"""
file = work / "their_settings.yaml"
file.write_text(theirs)

imported = rj.Config.from_reference(file)
published = rj.load_config("published")
lines = [f"| `{key}` | {old} | **{new}** |" for key, new, old in imported.difference(published)]
Markdown("\n".join(["| setting here | published | imported |", "| --- | --- | --- |", *lines]))

# %% [markdown]
# Four keys became four settings with other names. `runtime.device` is accepted and has no effect: JAX
# uses the device that it finds. On the command line the same is
#
# ```bash
# remind config import-reference their_settings.yaml --out mine.yaml
# remind run rooms.mp4 --masks masks/ --config mine.yaml
# ```
#
# `imported` can also be passed directly: `rj.run(..., config=imported)`.

# %% [markdown]
# ## What is refused
#
# A key that the original does not have, and a value that we do not support, are errors before
# anything runs. The message names the key and what is allowed.

# %%
refused = {
    "a misspelt key": {"association": {"matching": {"match_treshold": 0.7}}},
    "a memory without bound": {"update": {"appearance_memory": {"enabled": False}}},
    "an unknown choice": {"association": {"matching": {"object_mode": "median"}}},
}
for what, settings in refused.items():
    try:
        rj.Config.from_reference(settings)
    except rj.RemindError as error:
        print(f"{what}:\n    {error}\n")

# %% [markdown]
# Every key of the original is in the record of a setting or in `remind_jax.config.reference_keys`; a test
# checks that none is missing. *Inert* keys choose folders, detectors, debug output and the like: they
# never change an identity.

# %%
from remind_jax.config import reference_keys

decided = reference_keys.decided_settings(rj.load_config("published"))
records = [record for settings in decided.values() for record in settings.values()]
pairs = {key for key in decided if any(isinstance(r.key, tuple) and key in r.key for r in records)}
choices = {r.key for r in records if r.theirs is not None}
lists = {r.key for r in records if r.listed}
kinds = {
    "renamed": len(decided.keys() - pairs - choices - lists),
    "choices renamed": len(choices),
    "capacities": len(pairs),
    "several keys\ndecide together": len(reference_keys.SHIPPED),
    "one value only": len(reference_keys.FIXED),
    "inert keys\nor sections": len(reference_keys.INERT),
}
figure, axes = plt.subplots(figsize=(7, 2.6))
bars = axes.barh(list(kinds), list(kinds.values()), color="#0072B2")
axes.bar_label(bars, padding=3)
axes.invert_yaxis()
axes.set_xlabel("keys of the original")
figure.tight_layout()
plt.show()

# %% [markdown]
# [Every setting](../docs/thresholds.md) lists meaning,
# unit, paper symbol and the key of the original.

# %% [markdown]
# ## Do both decide the same?
#
# `tests/golden` holds small generated sequences and what the unmodified original decided on them,
# detection by detection. `tests/parity.py` runs our tracker on the same inputs with the imported
# settings. Agreement is exact for everything discrete (outcome, identity, candidates, sizes of all
# banks) and within 2e-6 for scores (1e-5 for the confidence). Double precision, because the original
# computes in it.

# %%
report_file = work / "parity.json"
command = [sys.executable, "../tests/parity.py", "../tests/golden"]
options = ["--names", "small", "--variants", "default", "--json", str(report_file)]
done = subprocess.run([*command, *options], capture_output=True, text=True)
print(done.stdout or done.stderr)

# %%
(report,) = json.loads(report_file.read_text())
groups = {
    "outcome, identity, reason": ("outcome", "object", "reason", "source"),
    "assignment and guards": ("hungarian", "lock", "guarded", "anchor"),
    "status and scores": ("status", "status_final", "n_close", "s1", "s2", "score", "confidence"),
    "candidates": ("candidates", "best", "cand.score_sim", "cand.score_final", "cand.eligible",
                   "cand.plausible", "cand.gate", "cand.bonus"),
    "undecided tracks": ("temp", "amb", "amb.score", "prov", "prov.score", "prov.blocked"),
}  # fmt: skip
group_of = {field: group for group, fields in groups.items() for field in fields}
tally = collections.defaultdict(lambda: [0, 0])
for field, (agreeing, compared) in report["fields"].items():
    count = tally[group_of.get(field, "memory: banks, graphs, counters")]
    count[0] += agreeing
    count[1] += compared
lines = [
    f"| {group} | {same} | {all_} | {same / all_:.2%} |" for group, (same, all_) in tally.items()
]
Markdown("\n".join(["| compared | agree | of | share |", "| --- | ---: | ---: | ---: |", *lines]))

# %% [markdown]
# The repository ships eight such traces: three sequences, each with more and more layers of rules
# switched on. `python tests/parity.py tests/golden` runs all of them and names the first difference,
# if any, by frame, detection and field. Record traces of your own runs in the same
# format (`tests/golden/README.md`) to check on your data.

# %% [markdown]
# ## Where the original differs from the paper
#
# `published` does what the original's code does. Some rules in the paper differ; where a setting gives
# the paper's rule, it is one line. Some of them:

# %%
rules_of_the_paper = {
    "object score: the global descriptor alone": {"static": {"object_channel": "global"}},
    "memory is updated only by certain matches": {"thresholds": {"update": {"gated": True}}},
    "an update moves a prototype by similarity": {
        "thresholds": {"appearance": {"gated_update": True}}
    },
    "similar parts are joined": {"static": {"part_resembling": "join"}},
    "long absent objects are removed": {"static": {"remove_objects": True}},
    "co-occurrence is counted in every frame": {
        "thresholds": {"cooccurrence": {"force_frames": 1}}
    },
}
lines = []
for rule, change in rules_of_the_paper.items():
    ((key, new, old),) = published.updated(change).difference(published)
    lines.append(f"| {rule} | `{key}` | {old} | {new} |")
head = ["| rule of the paper | setting | code, `published` | paper |", "| --- | --- | --- | --- |"]
Markdown("\n".join([*head, *lines]))

# %% [markdown]
# All of them together make a configuration like any other; write it to a file and give it to
# `--config`.

# %%
as_in_the_paper = published
for change in rules_of_the_paper.values():
    as_in_the_paper = as_in_the_paper.updated(change)
print(len(as_in_the_paper.difference(published)), "settings differ from `published`")

# %% [markdown]
# Rules without a setting, ties, rounding, and what we do differently on purpose: see
# [Parity](../docs/parity.md).
#
# ## Where to find things
#
# | in the original | here |
# | --- | --- |
# | the main script over a DAVIS folder | `remind run FOLDER --config published`, `rj.run(..., config="published")`; frame by frame: `rj.Tracker("published")` |
# | the YAML with some hundred keys | `remind config import-reference FILE` |
# | its DINOv3 weights | `remind convert`, then `--backbone dinov3-vits16 --weights FILE` |
# | the evaluator | `remind eval GT RUN --protocol paper`, beside the standard definitions |
# | result folders, videos | [Files](../docs/file_formats.md) |
#
# **Take-away.** Import your file and run: the decisions are the same. Where you want the paper's rule
# instead of the code's, there often is a setting for it.
