import numpy as np
import pytest

from remind_jax.detectors import DetectorOptions
from remind_jax.detectors.options import find_wanted_classes
from remind_jax.errors import ConfigError, OptionError


@pytest.mark.parametrize(
    ("field", "value", "allowed"),
    [
        ("confidence", 1.5, "0 to 1"),
        ("confidence", float("nan"), "0 to 1"),
        ("confidence", "high", "0 to 1"),
        ("iou", -0.1, "0 to 1"),
        ("mask_threshold", 0.0, "0.01 to 0.99"),
        ("max_detections", 0, "from 1 to"),
        ("erosion_px", -1, "from 0 to"),
        ("erosion_px", 1.5, "from 0 to"),
        ("erosion_px", True, "from 0 to"),
        ("min_mask_px", 0, "from 1 to"),
        ("input_size_px", 8, "from 32 to"),
        ("num_threads", 0, "from 1 to"),
        ("classes", "chair", "list of class names"),
        ("ignored_classes", None, "list of class names"),
        ("ignored_classes", [3], "list of class names"),
        # These would exhaust the machine.
        ("input_size_px", 10**9, "from 32 to"),
        ("num_threads", 10**6, "from 1 to"),
        ("erosion_px", 10**6, "from 0 to"),
        ("max_detections", 10**12, "from 1 to"),
        ("min_mask_px", 10**30, "from 1 to"),
        ("class_names", ["x" * 201], "give "),
        ("class_names", [""], "give "),
    ],
)
def test_a_bad_value_is_named_with_what_is_allowed(field, value, allowed):
    with pytest.raises(OptionError) as caught:
        DetectorOptions(**{field: value})
    message = str(caught.value)
    assert str(value)[:20] in message
    assert allowed in message


def test_class_lists_ignore_letter_case_and_exclusion_wins():
    options = DetectorOptions(classes=("Chair", "wall"), ignored_classes=("WALL",))
    assert options.admits("chair")
    assert not options.admits("Wall")
    assert not options.admits("cup")


def test_lists_from_yaml_give_equal_hashable_options():
    assert hash(DetectorOptions(classes=["cup"])) == hash(DetectorOptions(classes=("cup",)))  # type: ignore[arg-type]


def test_columns_without_a_name_are_never_wanted():
    names = ["cup", None, "Wall"]
    wanted = find_wanted_classes(names, DetectorOptions(ignored_classes=("wall",)))
    np.testing.assert_array_equal(wanted, [True, False, False])


def test_an_unknown_class_is_refused_with_the_nearest_name():
    with pytest.raises(ConfigError, match="did you mean 'chair'"):
        find_wanted_classes(["chair", "cup"], DetectorOptions(classes=("chiar",)))
    with pytest.raises(ConfigError, match="did you mean 'chair'"):
        find_wanted_classes(["chair", "cup"], DetectorOptions(ignored_classes=("chiar",)))
