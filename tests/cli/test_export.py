from remind_jax.metrics import evaluate


def test_the_file_lies_in_the_folder_of_the_run(command, run):
    outcome = command("export", run)
    assert outcome.code == 0
    # Long paths are wrapped.
    assert "".join(outcome.stdout.split()).endswith("cvat.xml:6identities,40frames")
    assert evaluate(run / "cvat.xml", run).scores()["IDF1"] == 1


def test_nothing_is_replaced_unasked(command, run):
    words = ("export", run, "--out", "a.xml", "--quiet")
    assert command(*words).code == 0
    again = command(*words)
    assert again.code == 1
    assert "exists; name another file" in again.stderr
    assert command(*words, "--overwrite").code == 0
