import numpy as np

from benchmarks.nearest_neighbor import Sightings, cosine_percentiles, rank_one


def make_sightings(frames, instances, labels=None):
    labels = ["thing"] * len(frames) if labels is None else labels
    unused = np.zeros((1, 16, 16, 3), np.uint8)
    columns = (np.zeros(len(frames), int), np.array(frames), np.array(instances), np.array(labels))
    return Sightings("made", unused, [], *columns)


def test_rank_one_asks_only_what_can_be_answered():
    sightings = make_sightings([0, 40, 40, 40], [1, 1, 2, 3])
    vectors = np.array([[1, 0], [0.8, 0.6], [0.6, 0.8], [1, 0]])
    assert rank_one(vectors, sightings, 30) == (0.5, 2)
    assert rank_one(vectors, sightings, 100) == (None, 0)


def test_cosines_are_sorted_by_kind_and_distance():
    sightings = make_sightings([0, 10, 40], [1, 2, 1], ["cup", "cup", "cup"])
    vectors = np.array([[1, 0], [0, 1], [0.6, 0.8]])
    cosines = cosine_percentiles(vectors, sightings)
    assert cosines == {
        "near class": [0.0] * 3,
        "far same": [0.6] * 3,
        "far class": [0.8] * 3,
    }
