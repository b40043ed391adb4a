import io
import tarfile

import pytest

from remind_jax.errors import SourceError
from remind_jax.sources import open_source
from remind_jax.sources.file_tree import FolderTree, TarTree, open_tree
from remind_jax.sources.source import UnreadableFrame
from tests.sources import making

FILES = {"scene/b/2.txt": b"two", "scene/b/10.txt": b"ten", "scene/a.txt": b"a", "scene/b/c/x": b""}


def write_member(path, name, *, size=None, **attributes):
    """A tar with one good image and one member of our choice."""
    with tarfile.open(path, "w") as archive:
        good = tarfile.TarInfo("frames/0.jpg")
        good.size = len(making.jpg(0))
        archive.addfile(good, io.BytesIO(making.jpg(0)))
        member = tarfile.TarInfo(name)
        for key, value in attributes.items():
            setattr(member, key, value)
        if size is not None:
            member.size = size
        archive.fileobj.write(member.tobuf())  # pyright: ignore[reportOptionalMemberAccess]
        archive.fileobj.write(bytes(1024))  # pyright: ignore[reportOptionalMemberAccess]


@pytest.mark.parametrize("kind", ["folder", "w", "w:gz", "w:bz2", "w:xz"])
def test_folder_and_tar_look_the_same(tmp_path, kind):
    if kind == "folder":
        for name, data in FILES.items():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_bytes(data)
        tree = open_tree(tmp_path / "scene")
    else:
        path = tmp_path / ("s.tar" + kind[1:].replace(":", "."))
        making.write_tar(path, FILES, kind)
        tree = open_tree(path)
    assert isinstance(tree, FolderTree if kind == "folder" else TarTree)
    assert tree.files_in("") == ["a.txt"]
    assert tree.files_in("b") == ["2.txt", "10.txt"]
    assert tree.folders_in("") == ["b"]
    assert tree.folders_in("b") == ["c"]
    assert tree.files_in("nowhere") == []
    assert tree.has_file("b/10.txt")
    assert not tree.has_file("b")
    assert tree.read("b/10.txt") == b"ten"
    assert tree.second_handle().read("b/2.txt") == b"two"
    assert tree.locate("b/2.txt").endswith("b/2.txt")


@pytest.mark.parametrize(
    ("name", "attributes", "why"),
    [
        ("/etc/passwd", {}, "lies outside"),
        ("\\evil.jpg", {}, "lies outside"),
        ("frames/../../evil.jpg", {}, "lies outside"),
        ("..", {"type": tarfile.DIRTYPE}, "lies outside"),
        ("frames/1.jpg", {"type": tarfile.SYMTYPE, "linkname": "/etc/passwd"}, "is no file"),
        ("frames/1.jpg", {"type": tarfile.LNKTYPE, "linkname": "frames/0.jpg"}, "is no file"),
        ("frames/1.jpg", {"type": tarfile.CHRTYPE}, "is no file"),
        ("frames/1.jpg", {"type": tarfile.FIFOTYPE}, "is no file"),
        ("frames/1.jpg", {"size": 1 << 40}, "claims 1099511627776 bytes"),
    ],
)
def test_hostile_members_are_refused(tmp_path, name, attributes, why):
    path = tmp_path / "x.tar"
    write_member(path, name, **attributes)
    with pytest.raises(SourceError, match=rf"archive '.*x\.tar' is refused: member .*{why}"):
        open_source(path)
    assert [p.name for p in tmp_path.iterdir()] == ["x.tar"], "nothing is unpacked"


def test_giant_member_of_a_compressed_tar_is_refused_before_it_is_unpacked(tmp_path):
    plain = tmp_path / "x.tar"
    write_member(plain, "frames/1.jpg", size=1 << 40)
    import gzip

    (tmp_path / "x.tar.gz").write_bytes(gzip.compress(plain.read_bytes()))
    with pytest.raises(SourceError, match="at most 536870912"):
        open_source(tmp_path / "x.tar.gz")


def test_headers_that_claim_memory_are_refused(tmp_path):
    import gzip

    header = tarfile.TarInfo("x")
    header.type, header.size = tarfile.XHDTYPE, 3 << 30
    with gzip.open(tmp_path / "x.tar.gz", "wb") as file:
        file.write(header.tobuf())
    with pytest.raises(SourceError, match="a header or member claims 3221225472 bytes"):
        open_source(tmp_path / "x.tar.gz")


def test_archives_that_unpack_to_far_more_than_they_are_are_refused(tmp_path):
    import gzip

    member = tarfile.TarInfo("film.mp4")
    member.size = 2 << 30
    zeros = gzip.compress(bytes(64 << 20))
    (tmp_path / "x.tar.gz").write_bytes(gzip.compress(member.tobuf()) + 32 * zeros)
    with pytest.raises(SourceError, match="it unpacks to over 1 GiB"):
        open_source(tmp_path / "x.tar.gz")


def test_members_without_a_name_are_refused(tmp_path):
    making.write_tar(tmp_path / "x.tar", {"": making.jpg(0)})
    with pytest.raises(SourceError, match="name"):
        open_source(tmp_path / "x.tar")


def test_links_in_circles_are_no_files(tmp_path):
    making.write_images(tmp_path, ["1.png"])
    (tmp_path / "0.png").symlink_to(tmp_path / "0.png")
    (tmp_path / "2.png").symlink_to("/dev/zero")
    assert [frame.name for frame in open_source(tmp_path)] == ["1.png"]


def test_truncated_tar_keeps_what_came_before(tmp_path):
    path = tmp_path / "x.tar"
    making.write_tar(path, {f"frames/{i}.jpg": making.jpg(i) for i in range(4)})
    with tarfile.open(path) as archive:
        third = archive.getmembers()[2]
    path.write_bytes(path.read_bytes()[: third.offset_data + third.size // 2])
    source = open_source(path)
    assert [f.name for f in source] == ["0.jpg", "1.jpg"]
    assert [s.name for s in source.skipped] == ["2.jpg", "rest"]


@pytest.mark.parametrize("content", [b"", b"no archive at all" * 100])
def test_damaged_archive_is_one_sentence(tmp_path, content):
    (tmp_path / "x.tar").write_bytes(content)
    with pytest.raises(SourceError, match=r"archive '.*x\.tar' (cannot be read|holds no files)"):
        open_source(tmp_path / "x.tar")


def test_short_member_is_unreadable(tmp_path):
    path = tmp_path / "x.tar"
    making.write_tar(path, {"d/a": b"a" * 2000, "d/b": b"b"})
    tree = TarTree(path)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(UnreadableFrame):
        tree.read("a")
