"""Vision transformers that are known by name: DINOv3, DINOv2, DINO (backbones.md#vit-variants)."""

from __future__ import annotations

import dataclasses
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


def _dinov3(name: str, width: int, depth: int, heads: int, hidden: int, mlp: Mlp) -> Variant:
    return Variant(
        name=f"dinov3-{name}",
        family="dinov3",
        width=width,
        depth=depth,
        heads=heads,
        patch_px=16,
        hidden=hidden,
        mlp=mlp,
        registers=4,
        qkv_bias="none" if name == "vit7b16" else "no key",
        norm_eps=1e-5,
    )


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


def _dino(name: str, width: int, heads: int, patch_px: int) -> Variant:
    return Variant(
        name=f"dino-{name}",
        family="dino",
        width=width,
        depth=12,
        heads=heads,
        patch_px=patch_px,
        hidden=4 * width,
        position="offset",
        table_side=224 // patch_px,
        layer_scale=False,
    )


_TABLE = (
    _dinov3("vits16", 384, 12, 6, 1536, "gelu"),
    _dinov3("vits16plus", 384, 12, 6, 1536, "swiglu"),
    _dinov3("vitb16", 768, 12, 12, 3072, "gelu"),
    _dinov3("vitl16", 1024, 24, 16, 4096, "gelu"),
    _dinov3("vitl16plus", 1024, 24, 16, 4096, "swiglu"),
    _dinov3("vith16plus", 1280, 32, 20, 5120, "swiglu"),
    _dinov3("vit7b16", 4096, 40, 32, 8192, "swiglu"),
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
    _dino("vits16", 384, 6, 16),
    _dino("vitb16", 768, 12, 16),
    _dino("vits8", 384, 6, 8),
    _dino("vitb8", 768, 12, 8),
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
