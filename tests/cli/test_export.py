from remind_jax.cli.main import main
from remind_jax.metrics import evaluate


def test_the_file_lies_in_the_folder_of_the_run(run, capsys):
    assert main(["export", str(run)]) == 0
    # Long paths are wrapped.
    said = "".join(capsys.readouterr().out.split())
    assert said.endswith("cvat.xml:6identities,40frames")
    assert evaluate(run / "cvat.xml", run).scores()["IDF1"] == 1


def test_nothing_is_replaced_unasked(run, tmp_path, capsys):
    words = ["export", str(run), "--out", str(tmp_path / "a.xml"), "--quiet"]
    assert main(words) == 0
    assert main(words) == 1
    assert "exists; name another file" in capsys.readouterr().err
    assert main([*words, "--overwrite"]) == 0
