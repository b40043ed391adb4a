"""`remind convert`: published weights of vision transformers, once, without PyTorch."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from remind_jax.cli.flags import flags
from remind_jax.errors import ConfigError
from remind_jax.printing.terminal import print_lines

if TYPE_CHECKING:
    from weights_convert.conversion import Conversion


@flags
class Convert:
    """Convert published weights of DINOv3, DINOv2 or DINO for 'remind run --weights'.

    The network is recognized by its tensors; every one is used, or reported.

    Networks that 'remind backbones' calls 'on first use' need no conversion.

    Examples:
      remind convert dinov3_vits16_pretrain_lvd1689m-08c60483.pth
      remind convert dinov3-vits16-pretrain-lvd1689m/ -o dinov3.safetensors
      remind convert dino_deitsmall16_pretrain.pth --variant dino-vits16
    """

    # official .pth, or Hugging Face's .safetensors, index of shards, or folder
    source: Annotated[Positional[Path | None], arg(metavar="[SOURCE]")] = None
    # converted file; NAME.safetensors where 'remind run' looks for it if left out
    out: Annotated[Path | None, arg(aliases=["-o"])] = None
    # refuse any other network; DINO, whose tensors any plain transformer has, must be named
    variant: Annotated[str | None, arg(metavar="NAME")] = None
    dtype: Literal["float32", "bfloat16"] = "float32"  # type that numbers are stored in
    # how position tables of DINO and DINOv2 without registers are resampled: offset, as the
    # official code, or size, as Hugging Face; that of the source if left out
    position: Literal["offset", "size"] | None = None
    heads: int | None = None  # attention heads, of networks that are none of the published
    custom: bool = False  # allow networks that are none of the published
    overwrite: bool = False  # replace an existing file
    json: bool = False  # print what was done as JSON
    quiet: bool = False  # say nothing but errors

    def execute(self) -> None:
        """Converts, checks and reports."""
        if self.source is None:
            raise ConfigError("name the weight file to convert; 'remind backbones' lists networks")
        from weights_convert.conversion import convert
        from weights_convert.variant_detection import Wishes

        wishes = Wishes(self.variant, self.heads, self.position, self.custom)
        done = convert(
            self.source, self.out, wishes=wishes, dtype=self.dtype, overwrite=self.overwrite
        )
        if self.json:
            print(json.dumps(_facts(done), indent=1))
        elif not self.quiet:
            print_lines(
                f"{done.path}: {done.variant.name}, {done.num_bytes / 2**20:.1f} MiB",
                f"  source   {done.layout}, sha256 {done.source_sha256}",
                f"  tensors  sha256 {done.data_sha256}",
                f"  licence  {done.licence}",
            )
            if done.dropped:
                print_lines(f"  left out, needed in training only: {', '.join(done.dropped)}")


def _facts(done: Conversion) -> dict[str, object]:
    return {
        "path": str(done.path),
        "variant": done.variant.name,
        "layout": done.layout,
        "bytes": done.num_bytes,
        "source_sha256": done.source_sha256,
        "data_sha256": done.data_sha256,
        "licence": done.licence,
        "dropped": list(done.dropped),
    }
