import pytest

from remind_jax.errors import ConfigError
from remind_jax.synthetic import LookalikeGroup, SceneOptions, demo_options, make_scene


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"num_rooms": 0}, "num_rooms=0 is not allowed; give a number from 1 to 12"),
        ({"name": "a/b"}, "name='a/b'"),
        ({"light_drop": 0.0}, "light_drop=0.0"),
        ({"frames": 40, "absence_frames": 40}, "do not fit into frames=40"),
        ({"moved": 0.7, "roaming": 0.8}, "moved, removed, swapped and roaming add up to 1.5"),
        ({"camera": "stil"}, "no way of the camera 'stil'; did you mean"),
        ({"classes": ("mugg",)}, "did you mean 'mug'"),
        ({"lookalikes": (LookalikeGroup("mug", 2, "identcal"),)}, "did you mean 'identical'"),
        ({"lookalikes": (LookalikeGroup("mug", 1),)}, "give 2 or more"),
        ({"lookalikes": (LookalikeGroup("mug", 2, rooms=(5,)),)}, "numbered 0 to 1"),
    ],
)
def test_bad_options_get_one_clear_sentence(values, message):
    with pytest.raises(ConfigError) as caught:
        SceneOptions(**values)
    assert message in str(caught.value)


def test_demo_asks_for_lookalikes_and_long_absences():
    options = demo_options()
    assert options.frames == 120
    assert (options.width, options.height) == (640, 480)
    scene = make_scene(options)
    (start, end), *_ = scene.path.away
    assert end - start >= 40
    assert sum(item.placements[0].room == 0 for item in scene.objects) >= 10
