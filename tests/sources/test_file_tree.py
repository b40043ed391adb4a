import pytest

from remind_jax.errors import SourceError
from remind_jax.sources import open_source
from remind_jax.sources.file_tree import files_in, folders_in
from tests.sources import making

FILES = {"b/2.txt": b"two", "b/10.txt": b"ten", "a.txt": b"a", "b/c/x": b"", ".hidden": b""}


def test_files_and_folders_by_name(tmp_path):
    making.write_files(tmp_path, FILES)
    assert files_in(tmp_path) == ["a.txt"]
    assert files_in(tmp_path / "b") == ["2.txt", "10.txt"]
    assert folders_in(tmp_path) == ["b"]
    assert folders_in(tmp_path / "b") == ["c"]
    assert files_in(tmp_path / "nowhere") == files_in(tmp_path / "a.txt") == []


@pytest.mark.parametrize("name", ["x.tar", "x.tar.gz", "x.TGZ", "x.zip"])
def test_archives_are_to_be_unpacked(tmp_path, name):
    (tmp_path / name).write_bytes(b"")
    with pytest.raises(SourceError, match="is packed; unpack it"):
        open_source(tmp_path / name)


def test_links_that_lead_nowhere_are_frames_that_cannot_be_read(tmp_path):
    making.write_images(tmp_path, ["1.png", "3.png"])
    (tmp_path / "0.png").symlink_to(tmp_path / "0.png")
    (tmp_path / "2.png").symlink_to(tmp_path / "gone.png")
    (tmp_path / "4.png").symlink_to("/dev/zero")
    source = open_source(tmp_path)
    assert [(frame.name, frame.source_index) for frame in source] == [("1.png", 1), ("3.png", 3)]
    assert [skipped.name for skipped in source.skipped] == ["0.png", "2.png"]
    assert folders_in(tmp_path) == []
