"""The setting reported on a scene was chosen without it."""

import numpy as np
import pytest

from remind_jax.errors import SweepError
from remind_jax.sweeps.cross_validation import choose_without, cross_validate
from remind_jax.sweeps.result import sign_of
from tests.sweeps.fake_bench import FakeBench, hill

SETTINGS = [{}, *({"matching.match": 0.4 + 0.05 * step} for step in range(12))]


def favourite(setting, scene):
    """Every scene has one setting that is best for it alone; setting 0.7 is second everywhere."""
    match = round(setting.get("matching.match", 0.0), 2)
    if match == round(0.4 + 0.05 * scene, 2):
        return {"IDF1": 1.0}
    return {"IDF1": 0.8 if match == 0.7 else 0.3}


def test_what_is_best_for_the_scene_held_out_does_not_count():
    result = FakeBench(favourite, tuple("abcd")).run(SETTINGS)
    validation = cross_validate(result)
    assert [fold.setting for fold in validation.folds] == [SETTINGS[7]] * 4
    np.testing.assert_allclose(validation.scores, 0.8)
    np.testing.assert_allclose(validation.gains, 0.5)
    assert all(fold.chosen_score == pytest.approx(0.8) for fold in validation.folds)


def test_choice_is_the_best_mean_over_the_others():
    result = FakeBench(hill, tuple("abc")).run(SETTINGS)
    column = result.table()[:, :, 0]
    for index, scene in enumerate("abc"):
        others = np.delete(column, index, axis=1).mean(axis=1)
        assert choose_without(result, scene) == int(np.argmax(others))


def test_where_less_is_better_the_least_is_best():
    """As the share of ambiguous detections; `hill` has none at 0.5."""
    result = FakeBench(hill, tuple("abc")).run(SETTINGS)
    (best,) = result.best("Ambiguous")
    assert best.setting == {"matching.match": 0.5}
    validation = cross_validate(result, "Ambiguous")
    assert {choose_without(result, scene, "Ambiguous") for scene in "abc"} == {best.index}
    np.testing.assert_allclose(validation.gains, 0.05)
    with pytest.raises(SweepError, match="no score 'Identities'"):
        sign_of("Identities")


def test_no_gain_is_told_where_the_configuration_was_not_swept():
    validation = cross_validate(FakeBench(favourite, tuple("abcd")).run(SETTINGS[1:]))
    np.testing.assert_allclose(validation.scores, 0.8)
    assert np.isnan(validation.gains).all()
    assert validation.to_markdown().count("| 0.800 | - | - | 0.800 |") == 4
    assert "no gain known without the setting {} (95 %" in validation.mean()


def test_one_scene_is_too_few():
    bench = FakeBench(hill, ("a",))
    with pytest.raises(SweepError, match="no scene but 'a'"):
        cross_validate(bench.run(SETTINGS))
    with pytest.raises(SweepError, match="no score 'IDF'"):
        cross_validate(FakeBench(hill).run(SETTINGS), "IDF")
