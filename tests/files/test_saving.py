"""Folders come to be whole, or not at all; they are locked against others, not the dead."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from remind_jax import files
from remind_jax.errors import OutputError


def fill(out, *texts):
    with files.replacing_folder(out / "maps" / "tour", out) as unfinished:
        for number, text in enumerate(texts):
            if isinstance(text, BaseException):
                raise text
            (unfinished / str(number)).write_text(text)


def read(out):
    return {str(p.relative_to(out)): p.read_text() for p in out.rglob("*") if p.is_file()}


def test_a_folder_takes_the_place_of_another(tmp_path):
    out = tmp_path / "out"
    fill(out, "a", "b")
    assert read(out) == {"maps/tour/0": "a", "maps/tour/1": "b"}
    (out / "mine").write_text("c")
    fill(out, "d")
    assert read(out) == {"maps/tour/0": "d", "mine": "c"}
    assert sorted(path.name for path in out.iterdir()) == ["maps", "mine"]


@pytest.mark.parametrize("stop", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("is_there", [True, False])
def test_nothing_changes_where_it_fails(tmp_path, stop, is_there):
    out = tmp_path / "out"
    if is_there:
        fill(out, "a", "b")
    with pytest.raises((OutputError, KeyboardInterrupt)) as caught:
        fill(out, "half", stop)
    if isinstance(stop, OSError):
        assert str(caught.value).startswith(f"cannot write '{out / 'maps' / 'tour'}': No space")
        assert "nothing there was changed" in str(caught.value)
    assert out.exists() == is_there
    if is_there:
        assert read(out) == {"maps/tour/0": "a", "maps/tour/1": "b"}
        assert [path.name for path in out.iterdir()] == ["maps"]


def test_stopped_between_the_two_the_former_one_comes_back(tmp_path, monkeypatch):
    out = tmp_path / "out"
    fill(out, "a")
    rename, num = type(out).rename, []

    def stop_at_second(path, target):
        num.append(path)
        if len(num) == 2:
            raise KeyboardInterrupt
        return rename(path, target)

    monkeypatch.setattr(type(out), "rename", stop_at_second)
    with pytest.raises(KeyboardInterrupt):
        fill(out, "b")
    assert len(num) == 3
    assert read(out) == {"maps/tour/0": "a"}


def test_links_to_nothing_and_files_are_no_folders(tmp_path):
    (tmp_path / "out").symlink_to(tmp_path / "nowhere")
    with pytest.raises(OutputError, match=r"out': it is a link that leads nowhere; choose another"):
        files.make_folder(tmp_path / "out")
    (tmp_path / "out").unlink()
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "tour").write_text("mine")
    with pytest.raises(OutputError, match=r"it is a file; name a folder"):
        fill(tmp_path, "a")
    assert read(tmp_path) == {"maps/tour": "mine"}


@pytest.mark.skipif(os.name == "nt", reason="no SIGKILL")
def test_what_a_killed_process_left_is_swept_up(tmp_path):
    code = (
        "import os, signal, sys; from pathlib import Path; from remind_jax import files\n"
        "out = Path(sys.argv[1])\n"
        "with files.replacing_folder(out / 'maps' / 'tour', out) as unfinished:\n"
        "    (unfinished / '0').write_text('half'); os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False)
    (left,) = tmp_path.glob("*.part")
    assert left.is_dir()
    files.remove_unfinished(tmp_path)
    assert read(tmp_path) == {}
    assert not left.exists()


HOLD = """
import sys, time
from pathlib import Path
from remind_jax import files
with files.locked(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


def hold(folder: Path) -> subprocess.Popen[bytes]:
    """A process that has the folder."""
    command = [sys.executable, "-c", HOLD, str(folder)]
    holder = subprocess.Popen(command, stdout=subprocess.PIPE)
    assert holder.stdout.readline() == b"held\n"
    return holder


def test_another_process_is_kept_out_until_it_is_dead(tmp_path):
    holder = hold(tmp_path)
    try:
        with pytest.raises(OutputError, match="in use by another run"), files.locked(tmp_path):
            pass
    finally:
        holder.kill()
        holder.communicate()
    with files.locked(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_was_made_for_nothing_is_removed(tmp_path):
    with files.locked(tmp_path / "new"):
        pass
    assert not (tmp_path / "new").exists()
    with files.locked(tmp_path / "new"):
        (tmp_path / "new" / "file").write_text("x")
    assert (tmp_path / "new" / "file").exists()


def test_what_the_dead_were_writing_is_removed(tmp_path):
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    with files.replacing(tmp_path / "table") as partial:
        partial.write_text("being written")
        left = partial.with_name(partial.name.replace(f".{os.getpid()}-", f".{dead.pid}-"))
        left.write_text("half")
        (tmp_path / "holiday.part").write_text("not ours")
        with files.locked(tmp_path):
            assert partial.exists()
            assert not left.exists()
    assert (tmp_path / "table").read_text() == "being written"
    assert (tmp_path / "holiday.part").exists()


def test_what_fails_leaves_the_older_file(tmp_path):
    (tmp_path / "table").write_text("older")
    with pytest.raises(OutputError, match="cannot write"), files.replacing(tmp_path / "table"):
        raise OSError(28, "No space left on device")
    assert [path.name for path in tmp_path.iterdir()] == ["table"]
    assert (tmp_path / "table").read_text() == "older"
