"""`calibrate`: reads scenes, compares views with two backbones, and keeps the thresholds found."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from remind_jax import __version__
from remind_jax.backbone.opening import open_backbone
from remind_jax.backbone.registry import DEFAULT_BACKBONE, Backbone
from remind_jax.calibration.comparisons import Comparisons, Views, compare_ends, compare_views
from remind_jax.calibration.estimate import PART_MERGE, estimate, estimate_part_merge, join
from remind_jax.calibration.reading import SceneViews, read_scene
from remind_jax.config import Config, load_config
from remind_jax.config.dotted_keys import flatten_fields, nest
from remind_jax.config.profiles import MadeFor, place_profile, write_profile
from remind_jax.detectors import DetectorOptions, as_detector
from remind_jax.errors import ConfigError, SourceError
from remind_jax.files import as_path
from remind_jax.method import PAPER_METHOD
from remind_jax.settings.ranges import check_option
from remind_jax.sources import Sampling, Source, open_source
from remind_jax.sources.opening import check_options

CONFIG = "remind"  # what a profile starts from, and whose thresholds fit the reference features
LEAST = 30  # comparisons of each kind
ENOUGH_ALIKE = 200  # comparisons within a class, from which on no others are needed
MAX_SEED = 2**31 - 1
ENDS = "ends of tracklets"


@dataclasses.dataclass(frozen=True)
class Calibration:
    """Thresholds of the paper's tracker for the features of one backbone."""

    made_for: MadeFor
    thresholds: dict[str, float]  # dotted
    path: Path | None = None  # where they were written

    def to_config(self) -> Config:
        """The configuration `remind` with these thresholds."""
        thresholds = nest(self.thresholds)
        return load_config(
            {"base": CONFIG, "profile": self.made_for.name, "thresholds": thresholds}
        )

    def save(self, path: str | Path | None = None) -> Calibration:
        """Writes the profile; where runs with this backbone find it if no file is named.

        Raises:
          ConfigError: If the file is named otherwise than a configuration.
          OutputError: If it cannot be written.
        """
        made_for = self.made_for
        place = place_profile(PAPER_METHOD, made_for.backbone, made_for.fingerprint)
        target = place if path is None else _as_profile_path(path)
        write_profile(target, CONFIG, made_for, nest(self.thresholds))
        return dataclasses.replace(self, path=target)


def calibrate(
    scenes: Any,
    *,
    backbone: str | Backbone = DEFAULT_BACKBONE,
    weights: str | Path | None = None,
    feature_cache: str | Path | None = None,
    detector: Any = None,
    detector_options: DetectorOptions | Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    seed: int = 0,
    sampling: Sampling | Mapping[str, Any] | None = None,
    **source_options: Any,
) -> Calibration:
    """Finds thresholds of the paper's tracker for the features of a backbone, and keeps them.

    Runs with this backbone and the configuration `remind` use them from then on.

    Args:
      out: File to write instead, to be given as a configuration.

    Raises:
      RemindError: If a scene is not accepted, or the scenes do not hold enough to compare.
    """
    check_options(source_options, calibrate, detector_options=DetectorOptions)
    check_option("seed", seed, 0, MAX_SEED)
    if out is not None:
        _as_profile_path(out)
    finder = as_detector(detector, detector_options)
    opened = open_backbone(backbone, weights=weights, feature_cache=feature_cache)
    reference = open_backbone(DEFAULT_BACKBONE, feature_cache=feature_cache)
    sources = [
        open_source(scene, sampling=sampling, **source_options) for scene in _as_list(scenes)
    ]
    config = start_for(opened)
    seen = [read_scene(source, config, (reference, opened), finder) for source in sources]
    compared = choose_comparisons(seen, seed)
    same = np.concatenate([one.same for one in compared])
    made_for = MadeFor(
        backbone=opened.name,
        fingerprint=opened.fingerprint,
        scenes=[source.name for source in sources],
        evidence=ENDS,
        same=int(same.sum()),
        other=int((~same).sum()),
        seed=seed,
        version=__version__,
    )
    found = estimate_from([scene.views for scene in seen], compared, config)
    return Calibration(made_for, found).save(out)


def start_for(backbone: Backbone) -> Config:
    """What the profile of a backbone is made from (calibration.md#the-map).

    Thresholds of the reference features, but for other features the published weight of the
    background: less is for patch statistics, whose objects and parts tell more.
    """
    config = load_config(CONFIG).for_backbone(DEFAULT_BACKBONE)
    if backbone.identity == open_backbone(DEFAULT_BACKBONE).identity:
        return config
    published = load_config(CONFIG).thresholds.similarity.background_weight
    return config.updated({"thresholds": {"similarity": {"background_weight": published}}})


def choose_comparisons(scenes: Sequence[SceneViews], seed: int) -> list[Comparisons]:
    """Comparisons in each scene; without those across classes if enough are left.

    Raises:
      SourceError: If there are too few of either kind.
    """
    chosen = [compare_ends(scene.tracklets, np.random.default_rng(seed)) for scene in scenes]
    same, other = _count(chosen)
    if min(same, other) < LEAST:
        names = ", ".join(f"'{scene.name}'" for scene in scenes)
        raise SourceError(
            f"{names}: there are {same} comparisons of an object with itself and {other} of "
            f"objects seen together, and {LEAST} of each are needed; give longer scenes, with "
            "several objects in view"
        )
    within = [pairs.only(pairs.same_class) for pairs in chosen]  # the tracker makes no others
    return within if _count(within)[1] >= ENOUGH_ALIKE else chosen


def estimate_from(
    views: Sequence[tuple[Views, ...]], compared: Sequence[Comparisons], config: Config
) -> dict[str, float]:
    """Thresholds from the views of all scenes with the reference and the other features."""
    start = _start(config)
    shares = (start["similarity.inner_share"], start["similarity.outer_share"])
    cosines = [
        np.concatenate([one.part_cosines() for one in of]) for of in zip(*views, strict=True)
    ]
    merge = estimate_part_merge(cosines[0], cosines[1], start)
    evidence = []
    for of_one, least in zip(zip(*views, strict=True), (start[PART_MERGE], merge), strict=True):
        parts = [
            compare_views(one.merge_parts(least), pairs, shares, config.static.switches.part_top)
            for one, pairs in zip(of_one, compared, strict=True)
        ]
        evidence.append(join(parts))
    same = np.concatenate([pairs.same for pairs in compared])
    found = estimate(evidence[0], evidence[1], same, start) | {PART_MERGE: merge}
    # What the shipped profile of the reference features changes beside those.
    published = _start(load_config(CONFIG))
    fixed = {key: value for key, value in start.items() if value != published[key]}
    return {key: round(value, 4) for key, value in sorted((fixed | found).items())}


def _as_profile_path(path: str | Path) -> Path:
    """A file that can be named as a configuration."""
    target = as_path(path, "the profile", ConfigError)
    if target.suffix not in (".yaml", ".yml"):
        raise ConfigError(f"'{target}' cannot be used as a configuration; give a .yaml file")
    return target


def _start(config: Config) -> dict[str, float]:
    return dict(flatten_fields(config.thresholds))


def _count(chosen: Sequence[Comparisons]) -> tuple[int, int]:
    same = sum(int(pairs.same.sum()) for pairs in chosen)
    return same, sum(len(pairs.same) for pairs in chosen) - same


def _as_list(scenes: Any) -> list[Any]:
    is_many = isinstance(scenes, (list, tuple)) and not isinstance(scenes, Source)
    found = list(scenes) if is_many else [scenes]
    if not found:
        raise SourceError("there are no scenes to calibrate on; give at least one")
    return found
