"""Runs that were stopped or killed go on as if they had not been; what differs is refused."""

import dataclasses
import json
import shutil
from pathlib import Path

import jax
import numpy as np
import pytest

import remind_jax as rj
from remind_jax import files
from remind_jax import method as methods
from remind_jax.errors import OptionError, OutputError, RemindError, SourceError
from remind_jax.method import get_method
from remind_jax.outputs.writer import CHECKPOINT_NAME, MEMORY_NAME
from remind_jax.session import checkpoint
from remind_jax.session.memory_file import load_memory, save_memory
from remind_jax.session.progress import Progress
from tests.cli import scenes
from tests.corpus.kills import compare_runs
from tests.outputs.fake_run import make_run

NUM = 8
PICTURES = [scenes.picture(index, (1, 2, 3) if index % 3 else (1, 3)) for index in range(NUM)]


def track(out: Path, pictures=PICTURES, **options) -> rj.Result:
    return rj.run(pictures, out=out, **{"tracker": "bank", "progress": False, **options})


@pytest.fixture(autouse=True)
def _checkpoints_of_short_runs(monkeypatch):
    monkeypatch.setattr(checkpoint, "EVERY_S", 0.0)
    monkeypatch.setattr(checkpoint, "MAX_OF_A_RUN", 1e6)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A run that nobody disturbed."""
    out = tmp_path_factory.mktemp("whole") / "run"
    track(out)
    return out


def break_off(out: Path, num: int, **options) -> None:
    """Leaves what a kill after some frames leaves: nothing is finished."""

    class Killed(BaseException):
        pass

    def stop(step: Progress) -> None:
        if step.num_done == num:
            shutil.copytree(out, out.with_name("killed"))
            raise Killed

    with pytest.raises(Killed):
        track(out, **{"progress": stop, **options})
    shutil.rmtree(out)
    out.with_name("killed").rename(out)


@pytest.mark.parametrize("num", [1, 4, NUM])
def test_a_killed_run_ends_as_if_nothing_had_happened(tmp_path, whole, num):
    break_off(tmp_path / "run", num)
    result = track(tmp_path / "run", resume=True)
    assert result.complete
    assert compare_runs(whole, tmp_path / "run") == []
    assert result.memory is not None
    assert result.memory.objects == len(result.objects())
    assert rj.Result.load(tmp_path / "run").memory == rj.Result.load(whole).memory == result.memory
    assert not (tmp_path / "run" / CHECKPOINT_NAME).exists()


@pytest.mark.parametrize(
    "options",
    [
        {"announce_after": 3},
        pytest.param({"trace": True, "tracker": "plus"}, marks=pytest.mark.slow),
    ],
)
def test_what_waits_and_traces_survive(tmp_path, options):
    given = {"overlay": False, **options}
    track(tmp_path / "whole", **given)
    break_off(tmp_path / "run", 5, **given)
    track(tmp_path / "run", resume=True, **given)
    assert compare_runs(tmp_path / "whole", tmp_path / "run") == []
    told = [rj.Result.load(tmp_path / name).events for name in ("whole", "run")]
    assert told[0] == told[1]
    if "trace" in given:
        one, other = (dict(np.load(tmp_path / name / "trace.npz")) for name in ("whole", "run"))
        jax.tree.map(np.testing.assert_array_equal, one, other)


def test_frames_that_the_detector_finds_too_much_in_are_left_out_then_as_well(tmp_path):
    def detect(image):
        (index,) = [n for n, (other, _) in enumerate(PICTURES) if np.array_equal(image, other)]
        return np.zeros((9000, 2, 2), bool) if index in (1, 5) else PICTURES[index][1]

    images = [image for image, _ in PICTURES]
    given = {"pictures": images, "detector": detect, "announce_after": 1}
    result = track(tmp_path / "whole", **given)
    assert [one.name for one in result.skipped] == ["000001", "000005"]
    assert "9000 detections" in result.skipped[0].reason
    assert [tracks.frame_index for tracks in result.tracks] == list(range(NUM - 2))
    break_off(tmp_path / "run", 4, **given)
    track(tmp_path / "run", resume=True, **given)
    assert compare_runs(tmp_path / "whole", tmp_path / "run") == []
    with pytest.raises(SourceError, match=r"has no frames: '000000' was left out, .*9000 detect"):
        track(tmp_path / "none", [images[1]], detector=detect)


def test_what_the_checkpoint_has_not_seen_is_left_out(tmp_path, whole):
    break_off(tmp_path / "run", 5)
    journal = tmp_path / "run" / CHECKPOINT_NAME / checkpoint.FRAMES_NAME
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join([*lines, lines[-1], lines[-1][:30]]))  # a line too much, one torn
    track(tmp_path / "run", resume=True)
    assert compare_runs(whole, tmp_path / "run") == []


def test_names_given_before_a_run_goes_on_are_told(tmp_path):
    track(tmp_path / "before", [scenes.picture(0, (1, 2, 4))], tracker="momentum")
    pictures = [scenes.picture(index) for index in range(NUM)]
    memory = tmp_path / "before" / MEMORY_NAME
    given = {"pictures": pictures, "memory": memory, "tracker": "momentum"}
    break_off(tmp_path / "run", 5, **given)
    kept = tmp_path / "run" / CHECKPOINT_NAME / MEMORY_NAME
    changed = load_memory(kept)
    for number in range(4):  # the last is new in this run
        changed.records.rename(number, f"my {number}")
    save_memory(kept, changed)
    for result in (
        track(tmp_path / "run", resume=True, **given),
        rj.Result.load(tmp_path / "run"),
        track(tmp_path / "run", resume=True, **given),
    ):
        last = result.tracks[-1]
        assert {last.display_name(row) for row in range(3)} == {"my 0", "my 1", "my 3"}
        assert [one.title for one in result.not_met()] == ["my 2"]


def test_a_memory_that_was_changed_since_is_told_without_all_its_objects(tmp_path):
    track(tmp_path / "before", PICTURES[:2], tracker="momentum")
    given = {"memory": tmp_path / "before" / MEMORY_NAME, "tracker": "momentum"}
    break_off(tmp_path / "run", 4, **given)
    changed = load_memory(given["memory"])
    changed.records.rename(0, "my mug")
    save_memory(given["memory"], changed)
    with pytest.raises(OutputError, match=r"begun with a memory of other .* names; give that one"):
        track(tmp_path / "run", resume=True, **given)


def test_an_interrupted_run_goes_on(tmp_path, whole):
    def stop(step: Progress) -> None:
        if step.num_done == 4:
            raise KeyboardInterrupt

    assert not track(tmp_path / "run", progress=stop).complete
    seen: list[int] = []
    track(tmp_path / "run", resume=True, progress=lambda step: seen.append(step.num_done))
    assert seen == list(range(1, NUM + 1))
    assert compare_runs(whole, tmp_path / "run") == []


def test_a_finished_run_is_given_back(whole):
    before = {path.name: path.stat().st_mtime_ns for path in whole.iterdir()}
    result = track(whole, resume=True)
    assert result.complete
    assert len(result) == NUM
    assert {path.name: path.stat().st_mtime_ns for path in whole.iterdir()} == before


def test_an_empty_folder_gets_a_new_run(tmp_path, whole):
    track(tmp_path / "run", resume=True)
    assert compare_runs(whole, tmp_path / "run") == []


OTHER_SIZE = [(image[:-16], labels[:-16]) for image, labels in PICTURES]


OTHERS = (
    (OTHER_SIZE, {}, "is not what the run was begun with"),
    (PICTURES[:2], {}, "num_frames 8, not 2"),
    (PICTURES, {"config": {"tracker": "bank", "match": 0.6}}, "config.thresholds.match 0"),
    (PICTURES, {"announce_after": 2}, "announce_after 1, not 2"),
    (PICTURES, {"tracker": "iou"}, "config.tracker 'bank', not 'iou'"),
    (PICTURES, {"name": "other"}, "name 'frames', not 'other'"),
)


def test_anything_else_is_refused_and_nothing_is_lost(tmp_path, whole):
    break_off(tmp_path / "run", 4)
    record = (tmp_path / "run" / "detections.jsonl").read_bytes()
    for pictures, options, said in OTHERS:
        with pytest.raises(RemindError, match=said):
            track(tmp_path / "run", pictures, resume=True, **options)
        assert (tmp_path / "run" / "detections.jsonl").read_bytes() == record
    track(tmp_path / "run", resume=True)
    assert compare_runs(whole, tmp_path / "run") == []


def test_other_code_of_an_own_method_is_refused_where_it_can_be_told(tmp_path, monkeypatch):
    package, out = get_method("bank"), tmp_path / "run"

    def own(value):
        decide = lambda *given, **options: (value, package.decide(*given, **options))[1]  # noqa: E731
        monkeypatch.setitem(methods._methods, "bank", dataclasses.replace(package, decide=decide))

    own(1)
    break_off(out, 4)
    for _ in range(2):
        own(2)
        with pytest.raises(OutputError, match=r"options.tracker_code '.*'; give what it was begun"):
            track(out, resume=True)
        own(1)
        assert track(out, resume=True).complete
    own(1)
    break_off(tmp_path / "other", 4)
    own(object())  # another one in every process, as what a notebook defines
    assert track(tmp_path / "other", resume=True).complete


def test_a_finished_run_of_an_earlier_version_says_no_options(tmp_path, whole):
    shutil.copytree(whole, tmp_path / "run")
    told = json.loads((tmp_path / "run" / "run.json").read_text())
    del told["info"]["options"]
    (tmp_path / "run" / "run.json").write_text(json.dumps(told))
    assert track(tmp_path / "run", resume=True).complete


def test_what_was_made_of_a_part_goes(tmp_path, whole):
    out = tmp_path / "run"
    break_off(out, 4)
    for name in ("label.html", "cvat.xml"):
        (out / name).write_text("of four frames")
    track(out, resume=True)
    assert compare_runs(whole, out) == []
    assert not {"label.html", "cvat.xml"} & {file.name for file in out.iterdir()}


def test_another_source_in_a_finished_folder_is_refused(whole):
    with pytest.raises(OutputError, match="was begun with name 'frames', not 'other'"):
        track(whole, resume=True, name="other")


def test_a_shorter_source_without_a_known_length(tmp_path):
    break_off(tmp_path / "run", 4, pictures=iter(PICTURES))
    with pytest.raises(SourceError, match="ends before frame 2"):
        track(tmp_path / "run", iter(PICTURES[:2]), resume=True)


@pytest.mark.parametrize(
    ("options", "said"),
    [({"overwrite": True}, "exclude each other"), ({"out": None}, "give out")],
)
def test_options_that_do_not_go_together(tmp_path, options, said):
    with pytest.raises(OptionError, match=said) as refused:
        rj.run(PICTURES, resume=True, **{"out": tmp_path / "run", **options})
    assert refused.value.spelled(lambda name: f"--{name}").count("'") == 0


def test_folders_without_a_run_are_refused(tmp_path, whole):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(OutputError, match="holds no run to go on with, but"):
        track(tmp_path, resume=True)
    earlier = tmp_path / "earlier"
    earlier.mkdir()
    shutil.copy(whole / "detections.jsonl", earlier)
    with pytest.raises(OutputError, match="left no checkpoints"):
        track(earlier, resume=True)


def test_a_folder_with_a_run_says_how_to_go_on(tmp_path):
    break_off(tmp_path / "run", 4)
    with pytest.raises(OutputError, match=r"go on with the run in it \(resume=True, --resume\)"):
        track(tmp_path / "run")
    assert track(tmp_path / "run", overwrite=True).complete


def test_two_runs_in_one_folder(tmp_path):
    with files.locked(tmp_path), pytest.raises(OutputError, match="in use by another run"):
        track(tmp_path)


def test_a_damaged_journal_is_refused_in_a_sentence(tmp_path):
    break_off(tmp_path / "run", 4)
    journal = tmp_path / "run" / CHECKPOINT_NAME / checkpoint.FRAMES_NAME
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join([lines[0], b"{}\n", *lines[2:]]))
    with pytest.raises(OutputError, match="line 2"):
        track(tmp_path / "run", resume=True)
    journal.write_bytes(b"".join(lines[:2]))
    with pytest.raises(OutputError, match="has 1 frames, the memory beside it has seen"):
        track(tmp_path / "run", resume=True)


def test_checkpoints_take_a_bounded_share_of_a_run(tmp_path, monkeypatch):
    """Each is followed by so much of the run that it was at most a hundredth of it."""
    now = [0.0]
    monkeypatch.setattr(checkpoint, "MAX_OF_A_RUN", 0.01)
    kept = checkpoint.Checkpoints(tmp_path, every_s=10.0, clock=lambda: now[0])
    kept.folder.mkdir()

    class Slow:
        state = dataclasses.make_dataclass("State", ["frame"])(1)

        def checkpoint(self, path):
            now[0] += 3.0

    step = make_run(1, (48, 64), 1)[1].tracks[0], checkpoint.Step({"step": 1.0}, 0.0)
    kept.add(*step)
    assert not kept.is_due
    now[0] = 10.0
    assert kept.is_due
    kept.save(Slow(), None)  # pyright: ignore[reportArgumentType]
    kept.add(*step)
    now[0] = 13.0 + 299.0
    assert not kept.is_due
    now[0] = 13.0 + 300.0
    assert kept.is_due
