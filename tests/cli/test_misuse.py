"""What people get wrong is told in one sentence that says what to do, before any work."""

import shlex
from pathlib import Path

import pytest

from remind_jax.cli import process
from tests.cli import scenes


@pytest.fixture
def things(tmp_path) -> Path:
    """A folder with what may be taken for something else."""
    scenes.write_scene(tmp_path / "scene", num=4)
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.txt").write_text("hello\n")
    (tmp_path / "runs" / "rooms").mkdir(parents=True)
    (tmp_path / "runs" / "rooms" / "detections.jsonl").write_text("")
    return tmp_path


RUN = "run scene/images --masks scene/masks --out out"
SWEEP = "sweep scene --set decision.new=1,2"
# Wrong usage: the shell was told something that the command does not have.
WRONG_USAGE = {
    "demo --sead 3": "--sead",
    "demo --seed many": "'many' is no whole number",
    "demo --seed": "--seed",
    "demo --quiet=3": "3",
    "view": "RUN",
    "explain a": "--frame",
    "memory --jsn": "memory",
    "view a b": "b",
    "eval a.txt b.txt --format mott": "'kitti-mots'",
    "config": "validate",
    "config shew": "show",
    "--sead": "--sead",
    "view a --\x1b[31m": r"\x1b[31m",
    f"view a --{'a' * 5000}": "aaa",
    "rum": "there is no verb 'rum'; did you mean 'run'?",
    "run a.mp4 --start 10 --end 5": "--end is 5; it is the frame to stop before and must lie after",
    "run a.mp4 --fps 0": "--fps is 0; give a number from 1e-06 to 1000000",
    "run a.mp4 --fps 5 --stride 2": "both --fps (5) and --stride (2) are given; give one",
    "run a.mp4 --stride 0": "--stride is 0; give a whole number from 1 to",
    "run a.mp4 --start -1": "--start is -1; give a whole number from 0",
    "run a.mp4 --max-frames 0": "--max-frames is 0; give a whole number from 1",
    "run a.mp4 --confidence 3": "--confidence is 3; give a number from 0 to 1",
    "run a.mp4 --input-size-px 7": "--input-size-px is 7; give a whole number from 32",
    "run a.mp4 --stride many": "'many' is no whole number",
    "run a.mp4 --stride 1_0": "'1_0' is no whole number",
    "run a.mp4 --stride ٣": "is no whole number",
    "run a.mp4 --fps fast": "'fast' is no number",
    "run a.mp4 --fps 1_0.5": "'1_0.5' is no number",
    "run a.mp4 --confidnce 0.3": "--confidence",
    "run --live 0 --no-overlay": "SOURCE",
    f"{RUN} --live {'9' * 5000}": "give HOST:PORT",
    f"{RUN} --image-fps 0": "--image-fps is 0; give a number from 1e-06 to 1000000",
    f"{RUN} --classes": "Error parsing --classes: nothing follows it",
    f"{RUN} --ignored-classes": "Error parsing --ignored-classes: nothing follows it",
    f"{RUN} --set": "Error parsing --set: nothing follows it",
    f"{RUN} --duration 5": "--duration is for a camera or a stream",
    f"{RUN} --live 8642": "--live is '8642'; give HOST:PORT, as 127.0.0.1:8642",
    f"{RUN} --classes chair": "--classes is for a detector; give --detector",
    f"{RUN} --confidence 0.7": "--confidence is for a detector; give --detector",
    f"{RUN} --sequence bear": "--sequence is 'bear', and '",
    f"{RUN} --record out": "--record and --out are the same folder; give",
    f"{RUN} --delay -1": "--delay is -1; give a whole number from 0",
    "eval notes.txt notes.txt --resamples -3": "--resamples is -3; give a whole number from 0",
    "eval notes.txt notes.txt --num-frames 0": "--num-frames is 0; give a whole number from 1",
    "benchmark scene --iou 0.4": "--iou is for a detector",
    f"{SWEEP} --random 0": "--random is 0",
    f"{SWEEP} --batch 0": "--batch is 0",
    f"{SWEEP} --top 0": "--top is 0",
    "calibrate nowhere --seed -1": "--seed",
    "calibrate nowhere --confidence 0.5": "--confidence is for a detector",
}
REFUSED = {
    "run scene/images --masks scene/images": "it is a color picture",
    f"{RUN} --config notes.txt": "'notes.txt' is no configuration; give a .yaml or",
    f"{RUN} --config defualt": "did you mean 'default'?",
    f"{RUN} --config missing.yaml": "cannot read 'missing.yaml'",
    f"{RUN} --set thresholds.decision.frim=0.7": "did you mean 'firm'?",
    f"{RUN} --set thresholds.decision.firm=high": "must be a number",
    f"{RUN} --set video.mp4": "'video.mp4' is no assignment; give --set KEY=VALUE",
    f"{RUN} --set =1": "'=1' is no assignment",
    f"{RUN} --set a..b=1": "'a..b=1' is no assignment",
    f"{RUN} --set a=[1": "the value of --set 'a=[1'",
    f"{RUN} --set input=1 input.close_px=2": "input in --set is 1; it must hold keys and values",
    f"{RUN} --set input.close_px=2 input=1": "input in --set is 1; it must hold keys and values",
    f"{RUN} --memory missing.safetensors": "cannot read 'missing.safetensors'",
    f"{RUN} --memory empty": "is a folder; give the file, memory.safetensors",
    f"{RUN} --backbone patch-statistic": "did you mean 'patch-statistics'?",
    f"{RUN} --backbone patch-statistics+": "has nothing before or after a plus",
    f"{RUN} --backbone onnx:": "nothing follows 'onnx:' in backbone 'onnx:'; give a",
    f"{RUN} --backbone onnx": "give a file after a colon, 'onnx:FILE'",
    f"{RUN} --backbone vit": "'vit:FILE', or as weights (--weights FILE)",
    f"{RUN} --weights x.safetensors": "it needs none, leave them out",
    f"{RUN} --detector yolo11n-seg.pt": "yolo export model=yolo11n-seg.pt",
    "run scene/images --backbone vit": "'vit': missing a required argument: 'weights'; give a file",
    "demo --out scene": "holds no earlier run; choose another one with --out",
    "view nowhere": "'nowhere' is not the output folder of a run: it does not exist",
    "view runs/room": "it does not exist; runs beside it: rooms",
    "explain notes.txt --frame 0": "it is a file",
    "explain None --frame 0": "None",  # a name like any other
    "eval notes.txt": "no predictions to score against 'notes.txt'",
    "benchmark scene --detector x.engine": "is no ONNX file",
    "sweep": "name the scenes to sweep over",
    "sweep scene": "nothing to sweep over",
    "sweep scene --settings notes.txt": "holds no settings",
    "sweep scene --settings absent.csv": "absent.csv",
    "sweep scene --set decision.new=": "--set decision.new: '' in '' is no val",
    "sweep scene --set decision.new": "gives no values",
    "sweep scene --set decision.new=0.5:0.4": "first:last:step",
    f"{SWEEP} decision.new=2,3": "--set gives values of 'decision.new' twice; give them once",
    f"{SWEEP} --random 3 --search tpe": "exclude each other",
    f"{SWEEP} --settings x.csv": "exclude each other",
    f"{SWEEP} --metric MOTA": "no score 'MOTA'",
    "sweep nowhere --set matching.match=0.5": "nowhere",
    "config describe decision.firn": "did you mean 'firm'?",
    "config describe": "name the settings",
    "config show --backbone patch-statistic": "did you mean 'patch-statistics'?",
    "warmup 640": "'640' is no frame size; write WIDTHxHEIGHT",
    "warmup 640x": "'640x' is no frame size; write WIDTHxHEIGHT",
    "warmup 0x480": "'0x480' is no frame size; write WIDTHxHEIGHT",
    "warmup 640x480px": "'640x480px' is no frame size; write WIDTHxHEIGHT",
    "calibrate": "name the scenes to calibrate on",
    "calibrate a b --masks m": "--masks are those of one scene",
    "calibrate nowhere": "nowhere",
    "calibrate nowhere --out profile.txt": "profile.txt",
    "calibrate nowhere --detector none.onnx": "none.onnx",
    f"backbones {'a' * 50_000}": "[...]",  # never too long to be read
    "backbones dinov2-vits16": "did you mean 'dinov3-vits16' or 'dinov2-vits14'",
    "view \x1b[31mred\u202e\x07": r"\x1b[31mred\u202e\x07",  # names cannot command the terminal
}


@pytest.mark.parametrize(
    ("cases", "code"), [(WRONG_USAGE, process.USAGE), (REFUSED, process.ERROR)], ids=["usage", "no"]
)
def test_one_sentence_says_what_to_do(command, things, cases, code):
    for words, told in cases.items():
        outcome = command(*shlex.split(words))
        said = outcome.stderr
        assert outcome.code == code, (words, outcome)
        assert told in said, (words, said)
        assert said.startswith("remind: "), (words, said)
        assert said.count("\n") == 1, (words, said)
        assert len(said) < 6000, words
        assert "Errno" not in said, (words, said)
        assert "\x1b" not in said, (words, said)
        assert sorted(path.name for path in things.iterdir()) == [
            "empty",
            "notes.txt",
            "runs",
            "scene",
        ], words


@pytest.mark.parametrize("words", [("help",), ("help", "eval"), ("eval", "--help")])
def test_help_is_found_either_way(command, words):
    outcome = command(*words)
    assert outcome.code == process.FINE
    assert outcome.stdout.startswith("usage: remind")
