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
# # 07 Pure functions
#
# Every tracker is a few pure functions of arrays. You learn to
#
# * read a scene into stacked, padded arrays;
# * take a tracker through them with `jax.lax.scan`;
# * run settings side by side with `jax.vmap`;
# * read the memory, which is a pytree.
#
# For scores over many scenes there are [sweeps](03_sweep_and_pick_thresholds.ipynb).

# %%
import tempfile

import jax
import numpy as np

import remind_jax as rj
from remind_jax.synthetic import demo_options, make_scene, write_davis

tracker = rj.get_method("default")
tour = write_davis(make_scene(demo_options()), tempfile.mkdtemp())  # what `make demo` renders
scene = rj.stack_scene(tour)
features, masks, observed = scene.frames
print("features", features.patches.shape, "detections", masks.valid.sum())
print("room for", scene.static.num_objects, "objects")
jax.tree.map(np.shape, masks)

# %% [markdown]
# `scene.static` fixes the shapes, `scene.settings` are the numbers of the configuration: a pytree of
# scalars. `tracker.step` gives the memory after a frame, with the decisions about it.


# %%
def follow(settings):
    def advance(state, frame):
        state = tracker.step(state, *frame, static=scene.static, thresholds=settings)
        return state, (state.decisions.object_id, state.overflow.objects)

    return jax.lax.scan(advance, tracker.init(scene.static), scene.frames)


options = rj.compiler_options()  # compile in half of the time
state, (ids, lacking) = jax.jit(follow, compiler_options=options)(scene.settings)
print("identities", ids.shape, "objects", int((state.objects.id >= 0).sum()))
assert not lacking.any()  # a frame that needs more slots than there are changes nothing else

# %% [markdown]
# The same identities as `rj.Tracker` gives, frame by frame:

# %%
live = rj.Tracker()
for row, frame in enumerate(rj.open_source(tour)):
    found = live.update(frame.image, frame.detections)
    assert (np.asarray(ids)[row, : len(found)] == found.object_id).all()

# %% [markdown]
# A setting with a leading axis is many settings. Here a new object is from unlikely to likely, in log
# odds. `step` is `describe` and `decide`; what a frame shows is described once for all settings.


# %%
def follow_one(settings, frames):
    def advance(state, frame):
        seen = tracker.describe(*frame, static=scene.static, thresholds=scene.settings)
        state, _ = tracker.decide(state, seen, static=scene.static, thresholds=settings)
        return state, state.decisions.object_id

    return jax.lax.scan(advance, tracker.init(scene.static), frames)[1]


values = np.linspace(-6, 3, 8)
settings = rj.sweeps.stack(scene.settings, [{"decision.new": float(x)} for x in values])
follow_all = jax.jit(jax.vmap(follow_one, (0, None)), compiler_options=options)
many = follow_all(settings, scene.frames)
for value, found in zip(values, np.asarray(many), strict=True):
    print(f"decision.new {value:.1f}: {len(np.unique(found[found >= 0]))} identities")

# %% [markdown]
# **Take-away.** A tracker is a few pure functions of arrays: what you know of JAX applies. The paper's
# tracker is `rj.get_method("published")`; its scene is stacked with
# `rj.stack_scene(source, "published")`. A tracker of your own is registered as in
# [05](05_your_own_backbone_detector_or_rule.ipynb).
