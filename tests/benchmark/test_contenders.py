import pytest

from remind_jax.benchmark.contenders import all_contenders, make_contenders
from remind_jax.errors import ConfigError


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
