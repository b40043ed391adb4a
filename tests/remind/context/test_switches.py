"""How sets are built with switches that are not as shipped, against the original.

Rules: method.md#hypotheses, method.md#context-allowed.

Settings are read as the original writes them, so that the import is tested as well. Kept were
scenes that the switches change, drawn as those of `scenes.npz` but with other seeds.
"""

import json
from typing import Any

import jax
import numpy as np
import pytest

from remind_jax.config import Config
from remind_jax.config.dotted_keys import nest
from remind_jax.remind.context.veto import expect_neighbors
from tests.golden.load import load_cases, load_expected
from tests.statics import change_static

from .scenes import STATIC, Scene, list_scenes, read, read_view

pytestmark = pytest.mark.usefixtures("x64")
ROUNDING = 1e-12  # float64 sums and products of some tens of numbers below 1
SETS = "association.scores.neighbor_sets"
SWITCHES = {
    f"{SETS}.allow_partial_coverage",
    f"{SETS}.density_gate_min_edge_p",
    f"{SETS}.core.priors_top_m",
    f"{SETS}.max_set_size",
}
SCALE = "association.matching.neighbor_sets_context_veto.local.expected_topk_scale"
COUNT = f"{SETS}.context.k"
ANSWERS = ("hyp_valid", "hyp_members", "hyp_detections", "veto")
SCORES = ("hyp_score", "bonus_raw", "strength", "quality")


def list_cases() -> list[tuple[Scene, dict[str, Any], dict[str, np.ndarray]]]:
    """Scene, settings and the original's answer."""
    settings = json.loads(str(load_cases("context/switches")["settings"]))
    answers = load_expected("context/switches")
    scenes = enumerate(zip(list_scenes("switches"), settings, strict=True))
    return [
        (scene, given, {name: value[row] for name, value in answers.items()})
        for row, (scene, given) in scenes
    ]


def configure(settings: dict[str, Any]) -> Config:
    return Config.from_reference(nest(settings))


def answer_on(scene: Scene, settings: dict[str, Any]) -> dict[str, np.ndarray]:
    t = configure(settings).thresholds.as_arrays(STATIC.scalar)
    found = jax.device_get(read(scene, t))
    told = {f"hyp_{name}": value for name, value in vars(found.hypotheses).items()}
    return {**told, **vars(found.influence), "veto": found.veto}


def test_sets_with_other_switches():
    for scene, settings, expected in list_cases():
        if not SWITCHES & set(settings):
            continue
        found = answer_on(scene, settings)
        for name in ANSWERS:
            np.testing.assert_array_equal(found[name], expected[name], str(settings))
        for name in SCORES:
            np.testing.assert_allclose(
                found[name], expected[name], rtol=0, atol=ROUNDING, err_msg=f"{name} {settings}"
            )
        before = answer_on(scene, {k: v for k, v in settings.items() if k not in SWITCHES})
        felt = any(
            np.max(np.abs(found[name].astype(float) - before[name])) > 1e-6
            for name in ("veto", "bonus_raw", "strength")
        )
        assert felt, settings


_expect = jax.jit(expect_neighbors, static_argnames="static")


def expected_by(scene: Scene, config: Config) -> np.ndarray:
    t = config.thresholds.as_arrays(STATIC.scalar)
    listed = {
        name: getattr(config.static.switches, name)
        for name in ("expected_neighbours", "context_hypotheses")
    }
    static = change_static(STATIC, **listed)
    view = read_view(scene, t, static)
    return np.asarray(_expect(view, t.sets.min_link, static=static, t=t.veto))


def test_length_of_the_list_of_expected_neighbours():
    for scene, settings, expected in list_cases():
        if not {SCALE, COUNT} & set(settings):
            continue
        shown = expected_by(scene, configure(settings))
        np.testing.assert_array_equal(shown, expected["expected"], str(settings))
        other = SCALE if SCALE in settings else COUNT
        without = configure({key: value for key, value in settings.items() if key != other})
        assert np.any(shown != expected_by(scene, without)), settings
