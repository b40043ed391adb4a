"""Folders are locked against others, not against the dead; what these left is removed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from remind_jax import files
from remind_jax.errors import OutputError

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
