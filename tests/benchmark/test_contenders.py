import dataclasses

import pytest

from remind_jax import method as methods
from remind_jax.benchmark.contenders import all_contenders, make_contenders
from remind_jax.errors import ConfigError
from remind_jax.method import get_method


def test_contenders_by_name(tmp_path):
    names = all_contenders()
    assert names[:3] == ["default", "remind", "published"]
    assert {"ablation_greedy", "momentum", "running-mean", "bank", "iou"} <= set(names)
    assert "plus" not in names  # it is the default
    mine = tmp_path / "mine.yaml"
    mine.write_text("base: remind\nthresholds: {matching: {match: 0.5}}\n")
    (contender,) = make_contenders([str(mine)])
    assert contender.name == "mine"
    assert contender.config.thresholds.matching.match == 0.5
    with pytest.raises(ConfigError, match=r"no method 'bnak'.*'bank'"):
        make_contenders(["bnak"])
    ablations = make_contenders(["ablation_no_parts", "ablation_plus_no_layout"])
    assert [one.title for one in ablations] == ["remind: no parts", "plus: no layout"]
    assert len({one.title for one in make_contenders()}) == len(names)


def test_a_title_that_two_have_gives_way_to_their_names(monkeypatch):
    other = dataclasses.replace(get_method("bank"), name="bank-2")
    monkeypatch.setitem(methods._methods, "bank-2", other)
    assert [one.title for one in make_contenders(["bank", "bank-2"])] == ["bank", "bank-2"]


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (["bank", "bank"], "'bank'"),
        (["a/mine.yaml", "b/mine.yaml"], "'mine'"),
        (["a/default.yaml"], "'default'"),  # a configuration
        (["a/bank.yaml"], "'bank'"),  # a tracker
    ],
)
def test_no_two_share_a_row(tmp_path, monkeypatch, names, told):
    monkeypatch.chdir(tmp_path)
    for file in ("a/mine.yaml", "b/mine.yaml", "a/default.yaml", "a/bank.yaml"):
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).write_text("base: remind\n")
    with pytest.raises(ConfigError, match=told):
        make_contenders(names)
