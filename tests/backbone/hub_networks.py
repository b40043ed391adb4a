"""A small made network under a name of its own, published on what stands for the hub."""

import dataclasses
import hashlib
import inspect
import io
import time
import urllib.request
from pathlib import Path
from typing import Any

import huggingface_hub
import pytest
from safetensors.numpy import save

from remind_jax.backbone import published_weights, registry, vit_variants, vit_weights
from remind_jax.backbone.published_weights import PublishedWeights
from remind_jax.backbone.vit_weights import load_weights
from tests.golden.vit import load as golden
from tests.weights_convert.hugging_face import as_hugging_face
from tests.weights_convert.pth_files import write_pth
from weights_convert.conversion import convert
from weights_convert.variant_detection import Wishes

NAME, REPOSITORY = "dinov2-test", "facebook/test"
REVISION = "0123456789abcdef0123456789abcdef01234567"
FILE, PLAIN = "model.safetensors", "https://authors/test_pretrain.pth"
_DOWNLOAD = inspect.signature(huggingface_hub.hf_hub_download)


class LocalHub:
    """Files by address, instead of the hub and of authors' servers."""

    def __init__(self, files: dict[str, bytes], tmp_path: Path, patch: pytest.MonkeyPatch) -> None:
        self.files, self.fetched = files, []
        self.error: Exception | None = None  # that fetching ends with
        self.delay_s = 0.0
        patch.setattr(huggingface_hub, "hf_hub_download", self._download)
        patch.setattr(urllib.request, "urlopen", lambda it, **_: io.BytesIO(self._read(it)))
        patch.setattr(huggingface_hub.constants, "HF_HUB_CACHE", str(tmp_path / "hf" / "hub"))

    def _download(self, *given: str, **options: Any) -> None:
        asked = _DOWNLOAD.bind(*given, **options).arguments
        content = self._read("/".join(asked[name] for name in ("repo_id", "revision", "filename")))
        (asked["local_dir"] / asked["filename"]).write_bytes(content)

    def _read(self, address: str) -> bytes:
        self.fetched.append(address)
        time.sleep(self.delay_s)
        if self.error is not None:
            raise self.error
        return self.files[address]


@dataclasses.dataclass(frozen=True)
class Published:
    """A hub with one network on it, once as the hub has it and once as authors do."""

    hub: LocalHub
    content: bytes
    pickled: bytes
    cache: Path  # folder of converted weights
    monkeypatch: pytest.MonkeyPatch

    @property
    def kept(self) -> list[str]:
        """What is in the folder of weights, locks aside."""
        found = (p for p in self.cache.rglob("*") if p.is_file() and p.suffix != ".lock")
        return sorted(str(path.relative_to(self.cache)) for path in found)

    def publish(self, **changes: object) -> None:
        """Changes what the table says of the network."""
        entry = dataclasses.replace(published_weights.PUBLISHED[NAME], **changes)
        self.monkeypatch.setitem(published_weights.PUBLISHED, NAME, entry)

    def publish_plain(self, **changes: object) -> None:
        """Lets the table name a file of an authors' server."""
        entry = PublishedWeights(
            PLAIN.rpartition("/")[2],
            address=PLAIN,
            sha256=hashlib.sha256(self.pickled).hexdigest(),
            num_bytes=len(self.pickled),
        )
        self.monkeypatch.setitem(published_weights.PUBLISHED, NAME, entry)
        self.publish(**changes)


def published_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Published:
    """Publishes the network."""
    official = golden.load("dinov2_tiny").official()
    content = save(as_hugging_face(official, "dinov2"))
    pickled = write_pth(tmp_path / "made.pth", official).read_bytes()
    (tmp_path / "made.safetensors").write_bytes(content)
    convert(tmp_path / "made.safetensors", tmp_path / "x.safetensors", wishes=Wishes(custom=True))
    found = load_weights(tmp_path / "x.safetensors").variant
    variant = dataclasses.replace(found, name=NAME, position="offset")
    monkeypatch.setitem(vit_variants.VARIANTS, NAME, variant)
    factory = f"remind_jax.backbone.vit_backbone:vit:{NAME}"
    monkeypatch.setitem(registry._factories, NAME, factory)
    monkeypatch.setattr(vit_weights, "user_cache_folder", lambda: tmp_path / "cache")
    monkeypatch.delenv(vit_weights.WEIGHTS_VARIABLE, raising=False)
    entry = PublishedWeights(
        FILE, REPOSITORY, REVISION, None, hashlib.sha256(content).hexdigest(), len(content)
    )
    monkeypatch.setitem(published_weights.PUBLISHED, NAME, entry)
    files = {f"{REPOSITORY}/{REVISION}/{FILE}": content, PLAIN: pickled}
    hub = LocalHub(files, tmp_path, monkeypatch)
    return Published(hub, content, pickled, tmp_path / "cache" / "weights", monkeypatch)
