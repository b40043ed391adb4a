"""Vision transformers that are known by name: DINOv3, DINOv2, DINO (backbones.md#vit-variants)."""

from __future__ import annotations

import dataclasses
import functools
from typing import Annotated, Literal

from msgspec import Meta

from remind_jax.errors import ConfigError, nearest_names
from remind_jax.files.records import Label

_Size = Annotated[int, Meta(ge=1, le=1 << 18)]
_Count = Annotated[int, Meta(ge=0, le=10_000)]

Family = Literal["dinov3", "dinov2", "dino"]
Mlp = Literal["gelu", "swiglu"]
QkvBias = Literal["all", "no key", "none"]
# Where a patch is: rotated queries and keys, or a table that is resampled to the patch grid by
#   offset     cubic, sampling step of the official code: (grid + 0.1) / table
#   size       cubic, sampling step grid / table, as Hugging Face's port of the same weights
#   antialias  cubic with low-pass filter
Position = Literal["rotary", "offset", "size", "antialias"]

CUSTOM = "custom"
ROTARY_BASE = 100.0


@dataclasses.dataclass(frozen=True)
class Variant:
    """All that is fixed about one transformer besides its weights; also in headers of files."""

    name: Label
    family: Family
    width: _Size  # D, features per token
    depth: Annotated[int, Meta(ge=1, le=1_000)]  # L, blocks
    heads: _Size
    patch_px: Annotated[int, Meta(ge=1, le=1_024)]
    hidden: _Size  # width inside the MLP; of each of the two halves with SwiGLU
    mlp: Mlp = "gelu"
    registers: _Count = 0
    qkv_bias: QkvBias = "all"
    position: Position = "rotary"
    table_side: _Count = 0  # M, the position table has M x M patches; 0: no table
    layer_scale: bool = True
    norm_eps: Annotated[float, Meta(gt=0.0, le=1.0)] = 1e-6
    cls_norm: bool = False  # cls and registers have a final norm of their own

    @property
    def head_width(self) -> int:
        """Features per attention head."""
        return self.width // self.heads

    @property
    def num_prefix(self) -> int:
        """Tokens before the patches: cls and registers."""
        return 1 + self.registers

    def check(self) -> None:
        """Raises a `ConfigError` if the numbers contradict each other."""
        if self.width % self.heads:
            raise ConfigError(
                f"{self.width} features cannot be split among {self.heads} attention heads; give a "
                "number of heads that divides them"
            )
        if self.position == "rotary" and self.head_width % 4:
            raise ConfigError(
                f"attention heads of {self.head_width} features cannot be rotated by two axes; "
                "their width must be a multiple of 4"
            )


_DINOV3 = functools.partial(
    Variant, family="dinov3", patch_px=16, registers=4, qkv_bias="no key", norm_eps=1e-5
)
_DINO = functools.partial(Variant, family="dino", depth=12, position="offset", layer_scale=False)


def _dinov2(name: str, width: int, depth: int, heads: int, registers: int) -> Variant:
    return Variant(
        name=f"dinov2-{name}" + ("-reg" if registers else ""),
        family="dinov2",
        width=width,
        depth=depth,
        heads=heads,
        patch_px=14,
        hidden=4096 if name == "vitg14" else 4 * width,
        mlp="swiglu" if name == "vitg14" else "gelu",
        registers=registers,
        position="antialias" if registers else "offset",
        table_side=37,
    )


_TABLE = (
    _DINOV3("dinov3-vits16", width=384, depth=12, heads=6, hidden=1536),
    _DINOV3("dinov3-vits16plus", width=384, depth=12, heads=6, hidden=1536, mlp="swiglu"),
    _DINOV3("dinov3-vitb16", width=768, depth=12, heads=12, hidden=3072),
    _DINOV3("dinov3-vitl16", width=1024, depth=24, heads=16, hidden=4096),
    _DINOV3("dinov3-vitl16plus", width=1024, depth=24, heads=16, hidden=4096, mlp="swiglu"),
    _DINOV3("dinov3-vith16plus", width=1280, depth=32, heads=20, hidden=5120, mlp="swiglu"),
    _DINOV3(
        "dinov3-vit7b16", width=4096, depth=40, heads=32, hidden=8192, mlp="swiglu", qkv_bias="none"
    ),
    *(
        _dinov2(name, width, depth, heads, registers)
        for registers in (0, 4)
        for name, width, depth, heads in (
            ("vits14", 384, 12, 6),
            ("vitb14", 768, 12, 12),
            ("vitl14", 1024, 24, 16),
            ("vitg14", 1536, 40, 24),
        )
    ),
    _DINO("dino-vits16", width=384, heads=6, patch_px=16, hidden=1536, table_side=14),
    _DINO("dino-vitb16", width=768, heads=12, patch_px=16, hidden=3072, table_side=14),
    _DINO("dino-vits8", width=384, heads=6, patch_px=8, hidden=1536, table_side=28),
    _DINO("dino-vitb8", width=768, heads=12, patch_px=8, hidden=3072, table_side=28),
)

VARIANTS: dict[str, Variant] = {variant.name: variant for variant in _TABLE}


def get_variant(name: str) -> Variant:
    """The variant called `name`. Raises ConfigError if there is none of this name."""
    if name not in VARIANTS:
        raise ConfigError(
            f"there is no vision transformer '{name}'; {nearest_names(name, VARIANTS)}"
        )
    return VARIANTS[name]


def name_of(variant: Variant) -> str:
    """The published name of an architecture, else `"custom"`.

    The rule by which a table is resampled is a choice of the reader, not of the weights.
    """
    for known in VARIANTS.values():
        renamed = dataclasses.replace(variant, name=known.name, position=known.position)
        if renamed == known and (variant.position == "rotary") == (known.position == "rotary"):
            return known.name
    return CUSTOM


@dataclasses.dataclass(frozen=True)
class Terms:
    """Where weights come from and what they may be used for."""

    license: str
    license_url: str
    source: str  # half a sentence: where to obtain them


TERMS: dict[Family, Terms] = {
    "dinov3": Terms(
        "DINOv3 License",
        "https://ai.meta.com/resources/models-and-libraries/dinov3-license/",
        "request access at https://ai.meta.com/resources/models-and-libraries/dinov3-downloads/ or "
        "on Hugging Face (facebook/dinov3-...-pretrain-lvd1689m)",
    ),
    "dinov2": Terms(
        "Apache-2.0",
        "https://github.com/facebookresearch/dinov2/blob/main/LICENSE",
        "download them from https://github.com/facebookresearch/dinov2 or from Hugging Face "
        "(facebook/dinov2-...)",
    ),
    "dino": Terms(
        "Apache-2.0",
        "https://github.com/facebookresearch/dino/blob/main/LICENSE",
        "download them from https://github.com/facebookresearch/dino or from Hugging Face "
        "(facebook/dino-...)",
    ),
}
