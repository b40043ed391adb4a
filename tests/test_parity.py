"""Agreement with the original tracker, in every compared field, on the sequences that ship.

`python tests/parity.py FOLDER` is the same for any folder of golden sequences.
"""

import json
from typing import Any

import jax
import numpy as np
import pytest

from tests import parity
from tests.golden import load

LADDER = ("core", "outcomes", "context", "default")  # each rung has one layer of rules more
RUNGS = [(name, variant) for variant in LADDER for name, v in load.list_traces() if v == variant]
QUICK = ("small", "default")


def check(name: str, variant: str) -> None:
    report = parity.compare_trace(name, variant, "float64", load.ROOT)
    assert not report.first
    assert report.agreeing == report.compared == len(load.load_trace(name, variant).det["frame"])
    for field, (agreeing, compared) in report.fields.items():
        assert agreeing == compared, field


def test_all_rungs_ship():
    assert {variant for _, variant in RUNGS} == set(LADDER)
    assert len(RUNGS) == len(load.list_traces()) == 8


@pytest.mark.parametrize("name", ["small", "stress", "two_rooms"])
def test_generated_inputs_are_the_recorded_ones(name):
    load.verify(name)


@pytest.mark.heavy
def test_published_configuration_decides_as_the_original(x64):
    check(*QUICK)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "variant"), [rung for rung in RUNGS if rung != QUICK])
def test_every_rung_agrees(x64, name, variant):
    check(name, variant)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["small", "stress", "two_rooms"])
def test_single_precision_agrees(name):
    report = parity.compare_trace(name, "default", "float32", load.ROOT)
    assert report.agreement >= 0.995


def test_command_reports_and_fails_below_the_minimum(monkeypatch, tmp_path, capsys):
    def compare(name: str, variant: str, precision: str, *_: Any) -> parity.Report:
        report = parity.Report(name, variant, precision, compared=10, agreeing=9)
        report.note(3, "detection 1", "object", 0, 2, same=False)
        return report

    monkeypatch.setattr(parity, "compare_trace", compare)
    before = jax.config.values["jax_enable_x64"]
    out = tmp_path / "report.json"
    words = [str(load.ROOT), "--names", "small", "--variants", "core,default", "--json", str(out)]
    try:
        assert parity.main([*words, "--min", "0.95"]) == 1
        assert parity.main([*words, "--min", "0.9"]) == 0
    finally:
        jax.config.update("jax_enable_x64", before)
    assert "9/10 agree (90.00 %); first: frame 3, detection 1" in capsys.readouterr().out
    rows = json.loads(out.read_text())
    assert [row["variant"] for row in rows] == ["core", "default"]
    np.testing.assert_allclose([row["agreement"] for row in rows], 0.9)
