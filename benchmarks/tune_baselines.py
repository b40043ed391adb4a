"""Chooses the thresholds of the baselines for a backbone: best mean IDF1 over generated tours.

The tours are those of seeds 1 to 6, on which REMIND's profile of patch statistics was chosen, too.
What comes out stands in `configs/backbones/<method>/<backbone>.yaml`.

    python benchmarks/tune_baselines.py [--backbone patch-statistics] [--weights FILE]
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import linear_sum_assignment

from remind_jax.backbone.opening import open_backbone
from remind_jax.masks.reduction import pad_masks
from remind_jax.method import get_method
from remind_jax.observation import FrameFeats
from remind_jax.session.live import Tracker
from remind_jax.synthetic import demo_options, make_scene, render

SEEDS = range(1, 7)
CAPACITIES = {"num_detections": 32, "num_objects": 512}  # wrong thresholds make many objects
COSINES = tuple(np.arange(0.30, 0.991, 0.03).round(2).tolist())
GRIDS: dict[str, dict[str, tuple[float, ...]]] = {
    "running-mean": {"match": COSINES},
    "bank": {"match": COSINES},
    "momentum": {
        "match": tuple(np.arange(0.35, 0.991, 0.04).round(2).tolist()),
        "logit_scale": (5.0, 10.0, 20.0, 40.0, 80.0),
    },
}


def main() -> None:
    """Prints the best values of each method and how flat the optimum is."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--backbone", default="patch-statistics")
    parser.add_argument("--weights")
    options = parser.parse_args()
    backbone = open_backbone(options.backbone, weights=options.weights)
    tours = [prepare(seed, backbone) for seed in SEEDS]
    for name, grid in GRIDS.items():
        settings = [
            dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())
        ]
        scores = np.mean([score_all(name, settings, *tour) for tour in tours], axis=0)
        order = np.argsort(-scores)[:5]
        print(name, *(f"{scores[i]:.3f} {settings[i]}" for i in order), sep="\n  ", flush=True)


def prepare(seed: int, backbone: Any) -> tuple[list[Any], list[np.ndarray]]:
    """Steps' inputs and true instances of one tour."""
    tracker = Tracker("default", backbone, tracker="bank")
    inputs, truth = [], []
    for frame in render(make_scene(demo_options(seed))):
        prepared = tracker.prepare(frame)
        assert prepared.image is not None
        patches = np.asarray(backbone.extract(prepared.image[None])[0])
        masks = pad_masks(prepared.masks, CAPACITIES["num_detections"])
        inputs.append((FrameFeats(patches, np.array(frame.size, np.int32)), masks))
        truth.append(prepared.detections.instance_ids)
    return inputs, truth


def score_all(
    name: str, settings: list[dict[str, float]], inputs: list[Any], truth: list[np.ndarray]
) -> list[float]:
    """IDF1 of every setting; all run side by side."""
    method, config = get_method(name), Tracker("default", tracker=name).config
    dim = inputs[0][0].patches.shape[-1]
    static = dataclasses.replace(config.static, feature_dim=dim, **CAPACITIES)
    swept = {key: jnp.array([s[key] for s in settings], jnp.float32) for key in settings[0]}
    base = jax.tree.map(lambda v: jnp.full(len(settings), v), method.settings())
    thresholds = dataclasses.replace(base, **swept)
    step = _compile(name, static)
    state = jax.vmap(lambda _: method.init(static))(jnp.arange(len(settings)))
    answers = []
    for feats, masks in inputs:
        state = step(state, feats, masks, thresholds=thresholds)
        answers.append(np.asarray(state.decisions.object_id))
    return [_idf1([a[k] for a in answers], truth) for k in range(len(settings))]


@functools.cache
def _compile(name: str, static: Any) -> Any:
    step = functools.partial(get_method(name).step, static=static)

    def advance(state: Any, feats: Any, masks: Any, *, thresholds: Any) -> Any:
        one = lambda s, t: step(s, feats, masks, thresholds=t)  # noqa: E731
        return jax.vmap(one)(state, thresholds)

    return jax.jit(advance)


def _idf1(answers: list[np.ndarray], truth: list[np.ndarray]) -> float:
    said = np.concatenate([a[: len(t)] for a, t in zip(answers, truth, strict=True)])
    true = np.concatenate(truth)
    table = np.zeros((true.max() + 1, said.max() + 1))
    np.add.at(table, (true[said >= 0], said[said >= 0]), 1)
    rows, columns = linear_sum_assignment(-table)
    return 2 * table[rows, columns].sum() / (len(true) + np.sum(said >= 0))


if __name__ == "__main__":
    main()
