import json

import numpy as np
import pytest

from remind_jax.detectors import DetectorOptions
from remind_jax.detectors.class_names import find_wanted_classes, read_class_names
from remind_jax.errors import ConfigError


@pytest.mark.parametrize(
    ("metadata", "expected"),
    [
        ({"names": "{0: 'person', 7: \"potted plant\"}"}, {0: "person", 7: "potted plant"}),
        ({"names": '["cup", "chair"]'}, {0: "cup", 1: "chair"}),
        ({"names": '{"0": "cup"}'}, {0: "cup"}),
        ({"rfdetr_inference": json.dumps({"class_id_to_name": {"1": "cup"}})}, {1: "cup"}),
        ({}, {}),
        ({"names": ""}, {}),
        ({"names": "person"}, {}),
        ({"names": "{'a': 'b'}"}, {}),
        ({"names": "[" * 100_000}, {}),
        ({"rfdetr_inference": "[]"}, {}),
    ],
)
def test_names_are_read_from_all_known_forms(metadata, expected):
    assert read_class_names(metadata) == expected


def test_nothing_in_a_file_is_executed(tmp_path):
    target = tmp_path / "made"
    assert read_class_names({"names": f"{{0: open({str(target)!r}, 'w')}}"}) == {}
    assert not target.exists()


def test_columns_without_a_name_are_never_wanted():
    names = ["cup", None, "Wall"]
    wanted = find_wanted_classes(names, DetectorOptions(ignored_classes=("wall",)))
    np.testing.assert_array_equal(wanted, [True, False, False])


def test_an_unknown_class_is_refused_with_the_nearest_name():
    with pytest.raises(ConfigError, match="did you mean 'chair'"):
        find_wanted_classes(["chair", "cup"], DetectorOptions(classes=("chiar",)))
