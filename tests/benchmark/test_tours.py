"""The rendered tours: what they are, and that they are rendered once."""

import dataclasses
from collections import Counter

import pytest

from remind_jax.benchmark import tours
from remind_jax.benchmark.scenes import find_scenes
from remind_jax.synthetic import make_scene
from tests.synthetic.conftest import TINY

SHORT = dataclasses.replace(TINY, frames=2, absence_frames=0)


def test_twelve_tours_of_seeds_that_nobody_tunes_on():
    made = tours.benchmark_tours()
    assert len({options.name for options in made}) == len(made) == 12
    assert sorted(options.seed for options in made) == list(range(100, 112))
    counts = Counter(options.name.rpartition("-")[0] for options in made)
    assert counts == dict.fromkeys(tours.AXES, 3)


@pytest.mark.slow
def test_every_tour_has_room_for_its_objects():
    for options in tours.benchmark_tours():
        scene = make_scene(options)
        assert len(scene.objects) == options.num_rooms * options.objects_per_room, options.name
        assert len(scene.path.away) == options.returns, options.name


def test_a_tour_is_rendered_once_and_found_again(tmp_path):
    rendered: list[str] = []
    first = tours.render_tours(tmp_path, (SHORT,), rendered.append)
    again = tours.render_tours(tmp_path, (SHORT,), rendered.append)
    assert first == again
    assert rendered == ["tiny"]
    (scene,) = find_scenes(first)
    assert scene.has_masks
    assert sum(1 for _ in scene.open()) == SHORT.frames

    other = tours.render_tours(tmp_path, (dataclasses.replace(SHORT, seed=1),), rendered.append)
    assert other != first
    assert rendered == ["tiny", "tiny"]


def test_an_unfinished_tour_is_not_there(tmp_path, monkeypatch):
    def fail(scene, folder):
        raise KeyboardInterrupt

    monkeypatch.setattr(tours, "write_davis", fail)
    with pytest.raises(KeyboardInterrupt):
        tours.render_tours(tmp_path, (SHORT,))
    assert not list(tmp_path.rglob("metadata.json"))
    monkeypatch.undo()
    assert find_scenes(tours.render_tours(tmp_path, (SHORT,)))
