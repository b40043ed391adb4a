"""Tours cut into visits."""

import dataclasses
import itertools

import pytest

from benchmarks.visits import kept_places, split_visits
from remind_jax.synthetic import render_sequence
from tests.synthetic.conftest import TINY

OPTIONS = dataclasses.replace(
    TINY, num_rooms=2, frames=12, absence_frames=4, moved=0.2, removed=0.2, added=0.2
)


@pytest.fixture(scope="module")
def tour():
    return render_sequence(OPTIONS)


def test_visits_are_the_tour_cut_in_its_absences(tour):
    visits = split_visits(tour)
    assert [visit.scene.name for visit in visits] == ["tiny-visit1", "tiny-visit2"]
    (away,) = tour.scene.path.away
    assert len(visits[0].frames) == sum(away) // 2
    whole = [frame.image for visit in visits for frame in visit.frames]
    assert all(one is other.image for one, other in zip(whole, tour.frames, strict=True))
    for visit in visits:
        assert [frame.index for frame in visit.frames] == list(range(len(visit.frames)))
        assert (visit.frames[0].source_index, visit.frames[0].time_s) == (0, 0.0)
        assert all(a.time_s < b.time_s for a, b in itertools.pairwise(visit.frames))


def test_a_tour_without_absence_is_one_visit():
    options = dataclasses.replace(OPTIONS, absence_frames=0, frames=2)
    assert len(split_visits(render_sequence(options))) == 1


def test_what_keeps_its_place(tour):
    kept = kept_places(tour.scene)
    changed = {item.instance_id for item in tour.scene.objects} - kept
    assert len(changed) == 3  # one moved, one taken away, one added
    last = tour.frames[-1].source_index
    for item in tour.scene.objects:
        stays = item.placement_at(0) == item.placement_at(last) is not None
        assert stays == (item.instance_id in kept)
