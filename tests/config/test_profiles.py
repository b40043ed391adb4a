"""Files of profiles: what they say is checked, and where they are kept."""

import os
from pathlib import Path

import pytest

from remind_jax.config import load_config, profiles
from remind_jax.errors import ConfigError

MADE_FOR = profiles.MadeFor("onnx:my encoder/é", "abc", scenes=["a"], same=40, other=50)
VALUES = {"matching": {"match": 0.61}}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(profiles.VARIABLE, str(tmp_path))
    return tmp_path


def test_names_are_fit_for_files_and_tell_features_apart():
    assert MADE_FOR.name.startswith("onnx_my_encoder__-")
    assert profiles.name_profile("a", "1") != profiles.name_profile("a", "2")
    assert profiles.name_profile("a\n1", "2") != profiles.name_profile("a", "1\n2")
    assert len(profiles.name_profile("x" * 500, "")) < 100


def test_a_profile_is_a_configuration(folder):
    path = profiles.place_profile("remind", MADE_FOR.backbone, MADE_FOR.fingerprint)
    assert not profiles.has_profile("remind", MADE_FOR.backbone)
    profiles.write_profile(path, "remind", MADE_FOR, VALUES)
    assert profiles.has_profile("remind", MADE_FOR.backbone)
    assert not profiles.has_profile("remind", "onnx:my")
    config = load_config(str(path))
    assert config.profile == MADE_FOR.name
    assert config.thresholds.matching.match == 0.61
    assert config.for_backbone(MADE_FOR.backbone, "abc") == config
    with pytest.raises(ConfigError, match="the features are those of onnx_my_encoder__-"):
        config.for_backbone(MADE_FOR.backbone, "abd")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("thresholds: {}\n", "is no profile of 'remind calibrate'"),
        ("base: remind\nprofile: {backbone: a}\nthresholds: {}\n", "missing required field"),
        ("base: remind\nprofile: 3\nthresholds: {}\n", "is not what 'remind calibrate' writes"),
        ("base: remind\nprofile: {backbone: a, fingerprint: b, x: 1}\nthresholds: {}\n", "`x`"),
        ("base: remind\nprofile: {backbone: a, fingerprint: b}\nthresholds: {no.such: 1}\n", "no"),
        (
            "base: plus\nprofile: {backbone: a, fingerprint: b}\nthresholds: {}\n",
            "`base`: .*'plus'",
        ),
        ("base: [remind]\nprofile: {backbone: a, fingerprint: b}\nthresholds: {}\n", "`base`: "),
        ("[", "not valid YAML"),
    ],
)
def test_what_is_no_profile_is_refused(folder, text, said):
    path = profiles.place_profile("remind", "a", "b")
    path.parent.mkdir(parents=True)
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=said):
        load_config("remind").for_backbone("a", "b")


@pytest.mark.parametrize(
    "make",
    [Path.mkdir, os.mkfifo, lambda path: path.symlink_to(path), lambda path: path.symlink_to("/x")],
)
def test_what_lies_in_its_place_is_not_passed_over(make):
    path = profiles.place_profile("remind", "a", "b")
    path.parent.mkdir(parents=True)
    make(path)
    with pytest.raises(ConfigError, match=r"remind/a-"):
        load_config("remind").for_backbone("a", "b")


@pytest.mark.parametrize("named", ["/etc/passwd", "/dev/zero", "x" * 5000])
def test_the_folder_of_profiles_is_one(named, monkeypatch):
    monkeypatch.setenv(profiles.VARIABLE, named)
    with pytest.raises(ConfigError, match=profiles.VARIABLE):
        load_config("remind").for_backbone("a", "b")
