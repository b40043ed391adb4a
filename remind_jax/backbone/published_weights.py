"""Where published weights are, pinned: file, revision, sha256, size.

A hash stands here if public code and records of several independent authors give the same one for
the same revision or file. Where no such record exists it is None: the architecture is checked then,
and the sha256 of what came is written into the converted file.
"""

from __future__ import annotations

import dataclasses

_HUB_FILE = "model.safetensors"
_AUTHORS = "https://dl.fbaipublicfiles.com"


@dataclasses.dataclass(frozen=True)
class PublishedWeights:
    """One file, on the hub (`repository` at `revision`) or on the authors' server (`address`)."""

    file: str
    repository: str | None = None
    revision: str | None = None  # commit
    address: str | None = None
    sha256: str | None = None
    num_bytes: int | None = None
    is_gated: bool = False  # given out on request only

    @property
    def origin(self) -> str:
        """What a converted file calls its source."""
        return self.address or f"{self.repository}/{self.file} at {self.revision}"

    @property
    def page(self) -> str:
        """Where a person reads about it, and asks for access."""
        return self.address or f"https://huggingface.co/{self.repository}"


def _on_hub(repository: str, revision: str, sha256: str, num_bytes: int | None) -> PublishedWeights:
    return PublishedWeights(_HUB_FILE, f"facebook/{repository}", revision, None, sha256, num_bytes)


def _on_request(repository: str, revision: str, sha256: str, num_bytes: int) -> PublishedWeights:
    on_hub = _on_hub(repository, revision, sha256, num_bytes)
    return dataclasses.replace(on_hub, is_gated=True)


def _from_authors(path: str, sha256: str | None, num_bytes: int | None) -> PublishedWeights:
    address = f"{_AUTHORS}/{path}"
    return PublishedWeights(
        address.rpartition("/")[2], address=address, sha256=sha256, num_bytes=num_bytes
    )


# By name of variant. Not here: DINOv3 L+ (no file is known) and 7B (six shards, 26 GB).
# fmt: off
PUBLISHED: dict[str, PublishedWeights] = {
    "dinov3-vits16": _on_request(
        "dinov3-vits16-pretrain-lvd1689m", "114c1379950215c8b35dfcd4e90a5c251dde0d32",
        "4610ad75edef83e75afdebf162d148dc628045ea6cbb83d67d4708c709c4f91d", 86_406_384),
    "dinov3-vits16plus": _on_request(
        "dinov3-vits16plus-pretrain-lvd1689m", "c93d816fc9e567563bc068f01475bec89cc634a6",
        "208146e499dace99e4c9376ddb8a26f77d64c31c46c4dc4b86ff8bc63b0235e2", 114_794_096),
    "dinov3-vitb16": _on_request(
        "dinov3-vitb16-pretrain-lvd1689m", "5931719e67bbdb9737e363e781fb0c67687896bc",
        "9a21ac3df0c63839d62612dda6f454d816c25611cc7a52966ed5a5a94921dc8b", 342_662_192),
    "dinov3-vitl16": _on_request(
        "dinov3-vitl16-pretrain-lvd1689m", "ea8dc2863c51be0a264bab82070e3e8836b02d51",
        "dcb2e45127cccbf1601e5f42fef165eea275c8e5213197e8dcf3f48822718179", 1_212_559_808),
    "dinov3-vith16plus": _on_request(
        "dinov3-vith16plus-pretrain-lvd1689m", "c807c9eeea853df70aec4069e6f56b28ddc82acc",
        "3e1d4d18b9bfa9f28fad8e9de6a783f1313532d3460efa4cd0b12521d81d1a4d", 3_362_432_800),
    "dinov2-vits14": _on_hub(
        "dinov2-small", "ed25f3a31f01632728cabb09d1542f84ab7b0056",
        "ae1e99fcefd534ed978cdeb8326f08030c96e28b7a81ffcbc98a857c84d14be1", 88_249_960),
    "dinov2-vitb14": _on_hub(
        "dinov2-base", "f9e44c814b77203eaa57a6bdbbd535f21ede1415",
        "d73036b56966966d07975d696bde331762f37297e2f095de8cea0040c3aa0841", 346_345_912),
    "dinov2-vitl14": _on_hub(
        "dinov2-large", "47b73eefe95e8d44ec3623f8890bd894b6ea2d6c",
        "399fba97a95f22c36834418bc69373364a99af3a1153da1c0fb31db567c92e23", 1_217_522_888),
    "dinov2-vitg14": _on_hub(
        "dinov2-giant", "611a9d42f2335e0f921f1e313ad3c1b7178d206d",
        "917d3c470db999d32a312f8542149be91c7cbac61ee8fb4b67ae3d82b79ce21f", 4_546_005_432),
    # The hub's S and L with registers have no hash that several authors give; these files have.
    "dinov2-vits14-reg": _from_authors(
        "dinov2/dinov2_vits14/dinov2_vits14_reg4_pretrain.pth",
        "f433177089a681826f849f194ece3bb48f4d63fb38d32fc837e3dc7a4e5641fb", None),
    "dinov2-vitb14-reg": _on_hub(
        "dinov2-with-registers-base", "a1d738ccfa7ae170945f210395d99dde8adb1805",
        "7a6f7b3b9fa4b8732e707476a03cd6cdce210048582f21aafb7991c17d98e362", None),
    "dinov2-vitl14-reg": _from_authors(
        "dinov2/dinov2_vitl14/dinov2_vitl14_reg4_pretrain.pth",
        "36e4deffbaef061a2576705b0c36f93621e2ae20bf6274694821b0b492551b51", 1_217_607_321),
    "dinov2-vitg14-reg": _on_hub(
        "dinov2-with-registers-giant", "8d0d49f77fb8b5dd78842496ff14afe7dd4d85cb",
        "c03832d44691e99b62ae28c4dfa2f134853a3614b3756c94f525109cce5a5051", 4_546_030_112),
    "dino-vits16": _from_authors(
        "dino/dino_deitsmall16_pretrain/dino_deitsmall16_pretrain.pth",
        None, 86_710_517),
    "dino-vitb16": _from_authors(
        "dino/dino_vitbase16_pretrain/dino_vitbase16_pretrain.pth",
        "bf34ad0f424b9029b593e8dc3ed553bf26e88bcba0d32bf3e62a6209cb64c85e", 343_242_485),
    "dino-vits8": _from_authors(
        "dino/dino_deitsmall8_pretrain/dino_deitsmall8_pretrain.pth",
        None, 86_728_949),
    "dino-vitb8": _from_authors(
        "dino/dino_vitbase8_pretrain/dino_vitbase8_pretrain.pth",
        "575f0efc4838938314afa09897a62ed2b87919928b5edcd133abb907328995eb", 343_279_349),
}
# fmt: on
