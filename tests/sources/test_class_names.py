import json

import pytest

from remind_jax.errors import SourceError
from remind_jax.sources.class_names import Metadata, parse_metadata, strip_number


def parse(content, sequence="room"):
    return parse_metadata(json.dumps(content).encode(), "m.json", sequence)


def test_number_of_a_label_is_cut_off():
    labels = ["chair_3", "game_controller_01", "tv", "_7", "cup 2", " mug_1 "]
    names = ["chair", "game_controller", "tv", "_7", "cup 2", "mug"]
    assert [strip_number(label) for label in labels] == names


def test_classes_win_over_labels():
    labels = {"1": "game_controller_01", "2": "cup_02"}
    classes = parse({"id_to_label": labels, "id_to_class": {"1": "game controller"}}).classes
    assert classes[1] == "game controller"
    assert classes[2] == "cup"
    assert classes.missing([1, 2, 5, 9, 5]) == [5, 9]


def test_plain_map():
    classes = parse({"1": "chair_3", "12": "tv"}).classes
    assert (classes[1], classes[12]) == ("chair", "tv")


def test_null_leaves_out_and_default_serves_the_rest():
    classes = parse({"id_to_class": {"1": "cup", "2": None}, "default_class": "thing"}).classes
    assert (classes[1], classes[2], classes[77]) == ("cup", None, "thing")
    assert classes.missing([1, 2, 77]) == []


def test_youtube_vos():
    videos = {"room": {"objects": {"1": {"category": "dog", "frames": ["00000"]}}}, "b": {}}
    assert parse({"videos": videos}).classes[1] == "dog"
    assert parse({"videos": videos}, "other") == Metadata()
    assert parse({"camera": "left"}) == Metadata()


def test_damaged_metadata_is_one_sentence():
    for content in (
        b"{",
        b"[1]",
        b'{"id_to_label": {"one": "cup"}}',
        b'{"id_to_label": {"1": 5}}',
        b'{"id_to_class": {"1": " "}}',
        b'{"default_class": 3}',
        b"[" * 100_000,
        b'{"id_to_class": {"99999999999": "a"}}',
        b'{"id_to_class": {"1": NaN}}',
        b'{"id_to_class": {"1": "' + b"x" * 201 + b'"}}',
        b'{"id_to_class": {"1": "a", "1": "b"}}',
        b'{"frame_names": ["../a.jpg"]}',
        b'{"frame_names": ["/a.jpg"]}',
        b'{"frame_names": ["a.jpg", "a.jpg"]}',
        "\u00e9".encode("latin-1"),
        b'{"segGroups": [{"objectId": [1]}]}',
        b'{"segGroups": [{"label": "a"}]}',
    ):
        with pytest.raises(SourceError, match=r"'m\.json'"):
            parse_metadata(content, "m.json", "room")
