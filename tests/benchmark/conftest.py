"""A data set of two tiny tours, on disk, and runs of methods on it."""

import dataclasses
from pathlib import Path

import pytest

from remind_jax.backbone.registry import get_backbone
from remind_jax.benchmark.contenders import make_contenders
from remind_jax.benchmark.running import Setup, run_all
from remind_jax.synthetic import make_scene, write_davis
from tests.synthetic.conftest import TINY

METHODS = ("bank", "iou")  # quick to compile


@pytest.fixture(scope="session")
def dataset(tmp_path_factory) -> Path:
    """Two scenes, named like tours, in the DAVIS layout."""
    folder = tmp_path_factory.mktemp("dataset")
    for seed, name in enumerate(("alike-1", "light-1")):
        options = dataclasses.replace(TINY, name=name, seed=seed, num_rooms=2, frames=8)
        write_davis(make_scene(options), folder / name)
    return folder


@pytest.fixture
def setup(tmp_path) -> Setup:
    return Setup(
        out=tmp_path / "out",
        backbone=get_backbone("patch-statistics"),
        feature_cache=tmp_path / "features",
    )


def run(setup, scenes, methods=METHODS):
    """Records, and the runs that were not there yet."""
    new = []

    def report(record, was_there):
        if not was_there:
            new.append((record.scene, record.contender))

    return run_all(setup, scenes, make_contenders(methods), report), new
