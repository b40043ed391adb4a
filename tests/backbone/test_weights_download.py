"""Weights by name, from a server on this machine that speaks the hub's protocol."""

from __future__ import annotations

import dataclasses
import errno
import json
import os
import pathlib
import re
import subprocess
import sys
import time
import types

import numpy as np
import pytest
from safetensors import safe_open

from remind_jax.backbone import get_backbone, hub_connection
from remind_jax.backbone.opening import open_backbone
from remind_jax.backbone.published_weights import PUBLISHED
from remind_jax.backbone.vit_variants import TERMS, VARIANTS
from remind_jax.backbone.vit_weights import load_weights
from remind_jax.backbone.weights_download import obtain_weights, place_of_original
from remind_jax.errors import OutputError, WeightsError
from tests.backbone.hub_networks import (
    FILE,
    NAME,
    PLAIN,
    REPOSITORY,
    REVISION,
    published_network,
)

CONVERTED = [f"{NAME}.safetensors"]


@pytest.fixture
def published(tmp_path, monkeypatch):
    monkeypatch.setattr(hub_connection, "_BETWEEN_TRIES_S", 0.0)
    with published_network(tmp_path, monkeypatch) as it:
        yield it


def told(**options) -> str:
    """The sentence of the error that ends fetching."""
    with pytest.raises((WeightsError, OutputError)) as caught:
        obtain_weights(NAME, quiet=True, **options)
    sentence = str(caught.value)
    assert "\n" not in sentence
    return sentence


class TestFetching:
    def test_a_name_is_enough(self, published):
        image = np.random.default_rng(0).integers(0, 256, (1, 70, 84, 3), np.uint8)
        features = get_backbone(NAME).extract(image)
        assert features.shape == (1, 5, 6, 64)
        assert published.kept == CONVERTED
        assert load_weights(published.cache / CONVERTED[0], NAME).variant.position == "offset"

    def test_once(self, published):
        first = obtain_weights(NAME)
        asked = len(published.hub.requests)
        assert obtain_weights(NAME) == first
        assert len(published.hub.requests) == asked

    def test_the_file_says_where_it_comes_from(self, published):
        with safe_open(obtain_weights(NAME), framework="np") as file:
            said = file.metadata()
        assert said["source"] == f"{REPOSITORY}/{FILE} at {REVISION}"
        assert said["source_sha256"] == PUBLISHED[NAME].sha256
        assert said["licence"] == "Apache-2.0"

    def test_a_converted_file_that_was_damaged_can_be_had_again(self, published):
        path = obtain_weights(NAME)
        path.write_bytes(path.read_bytes()[:-8])
        with pytest.raises(WeightsError, match="or remove it, and it is fetched again"):
            get_backbone(NAME)

    def test_given_weights_are_never_replaced(self, published, tmp_path):
        assert "no weights" in told(given=tmp_path / "mistyped.safetensors")
        assert published.hub.requests == []

    def test_license_and_size_are_said_once(self, published, capfd):
        obtain_weights(NAME)
        obtain_weights(NAME)
        out, err = capfd.readouterr()
        assert (out, err.count("\n")) == ("", 1)
        assert "Apache-2.0" in err
        assert TERMS["dinov2"].license_url in err
        assert f"(0.7 MiB) from {published.hub.address}/{REPOSITORY};" in err  # no other server

    def test_quiet_is_quiet(self, published, capfd):
        open_backbone(NAME, quiet=True)
        assert capfd.readouterr() == ("", "")

    def test_progress_on_a_terminal(self, published, capfd, monkeypatch):
        monkeypatch.setenv("FORCE_COLOR", "1")  # what rich takes for a terminal
        obtain_weights(NAME)
        assert re.search(r"dinov2-test.*/\S+ KiB", capfd.readouterr().err)

    def test_a_file_of_an_authors_server(self, published):
        published.publish_plain()
        assert load_weights(obtain_weights(NAME), NAME)
        assert published.hub.requests == [("GET", f"/{PLAIN}", "", False)]

    def test_without_a_known_hash_the_architecture_is_checked_and_the_hash_recorded(
        self, published
    ):
        published.publish_plain(sha256=None, num_bytes=None)
        with safe_open(obtain_weights(NAME), framework="np") as file:
            assert len(file.metadata()["source_sha256"]) == 64
        (published.cache / CONVERTED[0]).unlink()
        published.hub.files[PLAIN] = b"something else"
        assert "is not the network 'dinov2-test'" in told()
        assert published.kept == []


class TestHub:
    def test_redirects_are_followed_and_the_token_stays_behind(self, published, monkeypatch):
        monkeypatch.setenv("HF_TOKEN", "hf_secret")
        published.hub.behavior.renamed_from = "facebook/former"
        published.publish(repository="facebook/former")
        obtain_weights(NAME)
        assert [
            (kind, has) for kind, path, _, has in published.hub.requests if "/cdn/" in path
        ] == [("GET", False)]
        assert any(has for _, path, _, has in published.hub.requests if "/resolve/" in path)

    def test_what_the_hubs_cache_holds_is_used_and_left(self, published, tmp_path):
        folder = tmp_path / "hf" / "hub" / "models--facebook--test" / "snapshots" / REVISION
        folder.mkdir(parents=True)
        (folder / FILE).write_bytes(published.content)
        obtain_weights(NAME)
        assert published.hub.requests == []
        assert (folder / FILE).read_bytes() == published.content
        assert published.kept == CONVERTED

    def test_another_file_in_the_hubs_cache_is_not_used(self, published, tmp_path):
        folder = tmp_path / "hf" / "hub" / "models--facebook--test" / "snapshots" / REVISION
        folder.mkdir(parents=True)
        (folder / FILE).write_bytes(b"swapped")
        obtain_weights(NAME)
        assert published.kept == CONVERTED
        assert len(published.hub.requests) > 0

    @pytest.mark.parametrize(
        ("token", "admits", "why"),
        [
            (None, True, "no token is set"),
            ("hf_stale", True, "the token that is set is not accepted"),
            ("hf_right", False, "the account of the token that is set has no access yet"),
        ],
    )
    def test_gated_without_access(self, published, monkeypatch, token, admits, why):
        published.publish(is_gated=True)
        behavior = published.hub.behavior
        behavior.token, behavior.is_gated, behavior.admits = "hf_right", True, admits
        if token:
            monkeypatch.setenv("HF_TOKEN", token)
        sentence = told()
        assert why in sentence
        assert f"https://huggingface.co/{REPOSITORY}" in sentence
        assert "HF_TOKEN" in sentence
        assert published.kept == []

    def test_gated_with_access(self, published, monkeypatch):
        published.publish(is_gated=True)
        behavior = published.hub.behavior
        behavior.token, behavior.is_gated = "hf_right", True
        monkeypatch.setenv("HF_TOKEN", "hf_right")
        obtain_weights(NAME)
        assert published.kept == CONVERTED

    def test_a_token_that_is_refused(self, published, monkeypatch):
        published.hub.behavior.token = "hf_right"
        monkeypatch.setenv("HF_TOKEN", "hf_stale")
        assert "(answer 401): correct or unset HF_TOKEN" in told()

    @pytest.mark.parametrize("code", ["RepoNotFound", "RevisionNotFound", "EntryNotFound"])
    def test_not_there(self, published, code):
        published.hub.behavior.missing = code
        sentence = told()
        assert f"has no {REPOSITORY}/{FILE} at {REVISION}: unset HF_ENDPOINT" in sentence
        assert published.hub.address in sentence

    def test_a_server_in_trouble(self, published):
        published.hub.behavior.status = 500
        assert "(it answers 500): try again" in told()

    def test_wrong_content(self, published):
        swapped = bytearray(published.content)
        swapped[-1] ^= 1
        published.hub.files[f"{REPOSITORY}/{FILE}"] = bytes(swapped)
        sentence = told()
        assert "is not the published file: its sha256 is" in sentence
        assert str(PUBLISHED[NAME].sha256) in sentence
        assert published.kept == []

    def test_more_content_than_is_published(self, published):
        published.publish_plain()
        published.hub.files[PLAIN] += b"more"
        assert "is not the published file" in told()
        assert published.kept == []


class TestInterruptions:
    def test_connections_that_are_cut_are_followed_by_others(self, published):
        published.hub.behavior.cuts_after = 300_000
        obtain_weights(NAME)
        spans = [span for path, span in published.hub.bodies if "/resolve/" in path]
        assert spans == ["", "bytes=300000-", "bytes=600000-"]
        assert published.kept == CONVERTED

    def test_what_came_is_kept_and_gone_on_with(self, published):
        behavior = published.hub.behavior
        behavior.cuts_after = 0
        assert "cannot be fetched from" in told()
        behavior.cuts_after, behavior.num_cuts = 300_000, 1
        behavior.status = 0
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(hub_connection, "_MOST_TRIES", 1)
            sentence = told()
        assert "stopped coming" in sentence
        assert "after 0.3 MiB" in sentence
        assert "run this again to go on" in sentence
        assert published.kept == [f"{NAME}/{FILE}.partial"]
        published.hub.requests.clear()
        obtain_weights(NAME)
        assert published.hub.bodies[0][1] == "bytes=300000-"
        assert published.kept == CONVERTED

    def test_ctrl_c_leaves_what_came(self, published, monkeypatch):
        def interrupt(seconds):
            raise KeyboardInterrupt

        published.hub.behavior.cuts_after = 300_000
        monkeypatch.setattr(hub_connection, "time", types.SimpleNamespace(sleep=interrupt))
        with pytest.raises(KeyboardInterrupt):
            obtain_weights(NAME, quiet=True)
        assert published.kept == [f"{NAME}/{FILE}.partial"]

    @pytest.mark.parametrize("kind", ["ignores_ranges", "refuses_ranges"])
    def test_a_server_that_begins_again(self, published, kind):
        partial = place_of_original(NAME).with_name(FILE + ".partial")
        partial.parent.mkdir(parents=True)
        partial.write_bytes(published.content[:1000])
        setattr(published.hub.behavior, kind, True)
        obtain_weights(NAME)
        assert published.kept == CONVERTED

    def test_a_part_of_something_else_is_found_out(self, published):
        partial = place_of_original(NAME).with_name(FILE + ".partial")
        partial.parent.mkdir(parents=True)
        partial.write_bytes(b"?" * (len(published.content) + 1))
        assert "is not the published file" in told()
        obtain_weights(NAME)
        assert published.kept == CONVERTED

    def test_a_slow_server(self, published):
        published.hub.behavior.delay_s = 0.05
        obtain_weights(NAME)
        assert published.kept == CONVERTED

    def test_a_server_that_stops_answering(self, published, monkeypatch):
        from huggingface_hub import constants

        monkeypatch.setattr(constants, "HF_HUB_DOWNLOAD_TIMEOUT", 0.1)
        monkeypatch.setattr(hub_connection, "_MOST_TRIES", 2)
        published.hub.behavior.delay_s = 0.5
        assert "cannot be fetched from" in told()

    def test_no_connection(self, published, monkeypatch):
        from huggingface_hub import constants

        template = "http://127.0.0.1:9/{repo_id}/resolve/{revision}/{filename}"
        monkeypatch.setattr(constants, "ENDPOINT", "http://127.0.0.1:9")
        monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", template)
        sentence = told()
        assert "cannot be fetched from http://127.0.0.1:9" in sentence
        page = f"https://huggingface.co/{REPOSITORY}/resolve/{REVISION}/{FILE}"
        assert f"bring {page} to '{place_of_original(NAME)}' and run this again" in sentence

    def test_offline(self, published, monkeypatch):
        from huggingface_hub import constants

        monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
        sentence = told()
        assert "HF_HUB_OFFLINE forbids" in sentence
        assert f"to '{place_of_original(NAME)}'" in sentence
        assert published.hub.requests == []

    def test_a_file_brought_by_hand(self, published, monkeypatch):
        from huggingface_hub import constants

        monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
        place = place_of_original(NAME)
        place.parent.mkdir(parents=True)
        place.write_bytes(published.content[:-1])
        assert "is not the published file" in told()
        place.write_bytes(published.content)
        obtain_weights(NAME)
        assert published.kept == CONVERTED

    def test_without_the_library(self, published, monkeypatch):
        monkeypatch.setitem(sys.modules, "huggingface_hub", None)
        assert "pip install 'remind-jax[hub]', or bring " in told()

    def test_no_room(self, published, monkeypatch):
        nothing = types.SimpleNamespace(total=9, used=9, free=0)
        monkeypatch.setattr(hub_connection.shutil, "disk_usage", lambda _: nothing)
        assert "1.5 MiB are needed for a while, 0.0 MiB are free; make room" in told()

    def test_a_full_disk(self, published, monkeypatch):
        really_open = pathlib.Path.open

        def refuse(self, *words, **options):
            if self.suffix == ".partial":
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return really_open(self, *words, **options)

        monkeypatch.setattr(pathlib.Path, "open", refuse)
        assert "No space left on device; make room" in told()

    def test_a_folder_that_cannot_be_made(self, published):
        published.cache.parent.write_text("a file")
        assert "cannot make the output folder" in told()


# A fresh process, which knows the made network and reads the environment as users set it.
SCRIPT = """
import json, sys
from remind_jax.backbone.published_weights import PUBLISHED, PublishedWeights
from remind_jax.backbone.vit_variants import VARIANTS, Variant
from remind_jax.backbone.weights_download import obtain_weights
from remind_jax.errors import RemindError
name, variant, entry = json.loads(sys.argv[1])
VARIANTS[name], PUBLISHED[name] = Variant(**variant), PublishedWeights(**entry)
try:
    print(obtain_weights(name))
except RemindError as error:
    sys.exit(str(error))
"""


@pytest.fixture
def process(published, tmp_path):
    """Starts processes that want the weights."""
    told = [NAME, *(dataclasses.asdict(table[NAME]) for table in (VARIANTS, PUBLISHED))]
    known = {k: v for k, v in os.environ.items() if not k.startswith(("HF_", "REMIND_"))}
    started = []

    def start(**environment: str) -> subprocess.Popen[str]:
        new = subprocess.Popen(
            [sys.executable, "-c", SCRIPT, json.dumps(told)],
            env={**known, "XDG_CACHE_HOME": str(tmp_path), "HF_HOME": str(tmp_path / "home")}
            | {"HF_ENDPOINT": published.hub.address, **environment},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(new)
        return new

    yield start
    for one in started:
        one.kill()
        one.communicate()


def kept_in(tmp_path) -> list[str]:
    folder = tmp_path / "remind-jax" / "weights"
    found = (path for path in folder.rglob("*") if path.is_file() and path.suffix != ".lock")
    return sorted(str(path.relative_to(folder)) for path in found)


class TestProcesses:
    def test_the_environment_is_read(self, process, published, tmp_path):
        out, err = process(HF_HUB_OFFLINE="1").communicate()
        assert (out, published.hub.requests) == ("", [])
        assert "HF_HUB_OFFLINE forbids to fetch them" in err
        published.hub.behavior.token = "hf_right"
        (tmp_path / "home").mkdir(exist_ok=True)
        (tmp_path / "home" / "token").write_text("hf_right")  # as `hf auth login` leaves it
        out, err = process().communicate()
        assert out.strip() == str(tmp_path / "remind-jax" / "weights" / CONVERTED[0])
        assert err.count("\n") == 1
        assert kept_in(tmp_path) == CONVERTED

    def test_two_at_once_fetch_once(self, process, published, tmp_path):
        published.hub.behavior.delay_s = 0.1
        both = process(), process()
        outcomes = [one.communicate() for one in both]
        assert len({out for out, _ in outcomes}) == 1
        assert sum("fetching" in err for _, err in outcomes) == 1
        assert len([path for path, _ in published.hub.bodies if "/cdn/" in path]) == 1
        assert kept_in(tmp_path) == CONVERTED

    def test_one_that_is_killed_leaves_what_the_next_goes_on_with(
        self, process, published, tmp_path
    ):
        published.hub.behavior.delay_s = 0.2
        first = process()
        partial = tmp_path / "remind-jax" / "weights" / NAME / f"{FILE}.partial"
        until = time.monotonic() + 60
        while not (partial.is_file() and partial.stat().st_size) and time.monotonic() < until:
            time.sleep(0.02)
        first.kill()
        first.communicate()
        assert kept_in(tmp_path) == [f"{NAME}/{FILE}.partial"]
        published.hub.behavior.delay_s = 0.0
        published.hub.requests.clear()
        process().communicate()
        assert kept_in(tmp_path) == CONVERTED
        assert published.hub.bodies[0][1].startswith("bytes=")
