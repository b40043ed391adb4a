"""Which settings go together: same descriptors; batches that fit groups, memory and devices."""

import dataclasses
import types

import pytest

from remind_jax.sweeps import worker
from remind_jax.sweeps.worker import Worker, fit_batch, group_by_description, round_to_devices
from tests.sweeps.tiny_sweep import CONFIG, SCENES


def test_settings_that_see_the_same_share_descriptors():
    settings = [
        {"matching.match": 0.5},
        {"perception.trim_keep": 0.5, "matching.match": 0.6},
        {"matching.match": 0.7},
        {"matching.match": 0.8, "perception.trim_keep": 0.5},
        {"ring_prototypes.count": 3},
    ]
    seen = ("perception", "ring_prototypes.count")
    assert group_by_description(settings, seen) == [[0, 2], [1, 3], [4]]
    assert group_by_description(settings, ("ring_prototypes.c",)) == [[0, 1, 2, 3, 4]]


@pytest.mark.parametrize(
    ("sizes", "most", "batch"),
    [
        ([256], 32, 32),
        ([33], 32, 17),  # two batches of 17 rather than two of 32
        ([1] * 64, 32, 1),  # every setting sees something else: nothing goes side by side
        ([7], 32, 7),
        ([100, 100, 100], 32, 25),
        ([5], 1, 1),
    ],
)
def test_batch_fits_the_groups(sizes, most, batch):
    assert fit_batch(sizes, most) == batch


def test_batch_is_a_multiple_of_the_devices(monkeypatch):
    monkeypatch.setattr("jax.local_device_count", lambda: 8)
    assert [round_to_devices(number) for number in (1, 8, 9)] == [8, 8, 16]
    assert fit_batch([33], 256) == 40
    assert fit_batch([1] * 9, 256) == 8


@pytest.fixture
def staged(monkeypatch):
    """A worker whose runs are noted instead of done; memory has room for 84 objects in all."""
    note = types.SimpleNamespace(runs=[], described=0, grow_at=None, outgrows=False)

    def describe(scene, static, config):
        note.described += 1
        return scene

    def run(frames, config, settings, static, batch, budget):
        note.runs.append([setting.get("matching.match") for setting in settings])
        if len(note.runs) == note.grow_at:
            static = dataclasses.replace(static, num_objects=2 * static.num_objects)
            if note.outgrows and budget is not None:
                return None, static
        return settings, static

    def plan(frames, config, static, wanted, budget):
        note.capacities = static.num_detections, static.num_objects
        return min(wanted, 84 // static.num_objects), 1

    monkeypatch.setattr(worker, "describe_scene", describe)
    monkeypatch.setattr(worker, "run_batch", run)
    monkeypatch.setattr(worker, "plan_batch", plan)
    monkeypatch.setattr(
        worker, "score_batch", lambda scene, answers, static, batch: [dict(s) for s in answers]
    )
    return note


def run_all(crew, settings):
    from remind_jax.backbone.registry import get_backbone
    from remind_jax.sources import open_source
    from remind_jax.sweeps.scene_arrays import load_scene

    scene = load_scene(open_source(SCENES[0]), CONFIG, get_backbone("patch-statistics"))
    groups = group_by_description(settings, ("perception",))
    jobs = [{i: settings[i] for i in group} for group in groups]
    found = {}
    crew.start(scene, jobs, lambda numbers, rows: found.update(zip(numbers, rows, strict=True)))
    return [found[i] for i in range(len(settings))]


def test_every_setting_gets_its_own_row(staged):
    settings = [
        {"matching.match": 0.01 * i, "perception.trim_keep": 0.5 + 0.1 * (i % 2)} for i in range(15)
    ]
    assert run_all(Worker(CONFIG, 1.0), settings) == settings
    assert staged.described == 2
    assert staged.capacities == (6, 12)  # those of the scene, rounded
    assert sorted(len(run) for run in staged.runs) == [1, 7, 7]


@pytest.mark.parametrize(
    ("stage", "num", "options", "sizes"),
    [
        ({"grow_at": 2}, 21, {}, [7, 7, 3, 3, 1]),
        ({"grow_at": 2, "outgrows": True}, 14, {}, [7, 7, 3, 3, 1]),  # the second is done over
        ({"grow_at": 1}, 10, {"batch": 4}, [4, 4, 2]),
    ],
    ids=["is planned anew", "is done over in smaller batches", "keeps the batch asked for"],
)
def test_a_memory_that_grows(staged, stage, num, options, sizes):
    vars(staged).update(stage)
    settings = [{"matching.match": 0.01 * i} for i in range(num)]
    assert run_all(Worker(CONFIG, 1.0, **options), settings) == settings
    assert [len(run) for run in staged.runs] == sizes


def test_a_program_that_is_there_is_used_again(staged):
    crew = Worker(CONFIG, 1.0)
    run_all(crew, [{"matching.match": 0.01 * i} for i in range(7)])
    run_all(crew, [{"matching.match": 0.01 * i} for i in range(6)])
    assert crew.batch == 7
    run_all(crew, [{"matching.match": 0.5}])
    assert crew.batch == 1
