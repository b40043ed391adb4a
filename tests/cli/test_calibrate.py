"""`remind calibrate`: refusals before any work; what it finds is tested in tests/calibration."""

import pytest

from remind_jax.cli.main import main


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "name the scenes to calibrate on"),
        (["a", "b", "--masks", "m"], "--masks are those of one scene"),
        (["nowhere"], "nowhere"),
        (["nowhere", "--seed", "-1"], "--seed"),
        (["nowhere", "--out", "profile.txt"], "profile.txt"),
        (["nowhere", "--detector", "none.onnx"], "none.onnx"),
        (["nowhere", "--confidence", "0.5"], "--confidence is for a detector"),
    ],
)
def test_what_cannot_be_done_is_said_at_once(words, said, capsys):
    assert main(["calibrate", *words]) in (1, 2)
    complaint = capsys.readouterr().err
    assert said in complaint
    assert complaint.count("\n") <= 2
