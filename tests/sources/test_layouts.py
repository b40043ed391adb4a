import pytest

from remind_jax.errors import SourceError
from remind_jax.sources.layouts import Choice, locate, open_maps_at

from . import making

NAMES = ["a.jpg", "b.jpg"]


@pytest.mark.parametrize(("place", "opened", "num"), [("inside", "", 2), ("", "b.jpg", 1)])
def test_a_folder_of_one_folder_and_one_image_are_sequences(tmp_path, place, opened, num):
    making.write_images(tmp_path / place, NAMES)
    reader, open_masks = locate(tmp_path / opened, Choice())
    assert (reader.kind, reader.num_entries, open_masks) == ("images", num, None)


@pytest.mark.parametrize(
    ("files", "why"),
    [
        (["a.txt"], "holds no images .* recognized are a folder of images"),
        (["x/a.jpg", "y/a.jpg"], "its folders x, y do: give one of them"),
    ],
)
def test_a_folder_without_one_sequence_says_what_to_do(tmp_path, files, why):
    making.write_files(tmp_path, dict.fromkeys(files, making.jpg(0)))
    with pytest.raises(SourceError, match=why):
        locate(tmp_path, Choice())


def test_masks_are_no_frames_and_pictures_are_no_masks(tmp_path):
    (tmp_path / "d.json").write_text("[]")
    with pytest.raises(SourceError, match="give it as masks"):
        locate(tmp_path / "d.json", Choice())
    making.write_images(tmp_path / "v", NAMES)
    reader, _ = locate(tmp_path / "v", Choice())
    with pytest.raises(SourceError, match="holds no instance maps"):
        open_maps_at(tmp_path / "v", reader, Choice())
