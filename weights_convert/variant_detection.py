"""Which network a set of named tensors is; nothing is guessed (backbones.md#recognized-files)."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping
from typing import Any

from remind_jax.backbone.vit_variants import (
    CUSTOM,
    ROTARY_BASE,
    VARIANTS,
    Family,
    Variant,
    get_variant,
    name_of,
)
from remind_jax.detectors.onnx_model import MEAN, STD
from remind_jax.errors import WeightsError
from remind_jax.files.records import check
from weights_convert.key_layouts import NamedTensors
from weights_convert.stored_tensors import StoredTensor

_HEAD_WIDTH = 64  # of every published network but one
_WIDE_HEAD_WIDTH, _WIDE = 128, 4096  # DINOv3 7B
_SHOWN = ("depth", "width", "heads", "patch_px", "hidden", "mlp", "registers", "qkv_bias")
_CLASSIFIER = r"(head|classifier)\.(weight|bias)"


@dataclasses.dataclass(frozen=True)
class Wishes:
    """What the caller knows or decides about a network."""

    variant: str | None = None  # it must be this one
    heads: int | None = None  # in no weight; that of the published networks if left out
    position: str | None = None  # "offset" or "size" for DINO and DINOv2 without registers
    custom: bool = False  # allow networks that nobody has published


def detect_variant(
    named: NamedTensors, config: Mapping[str, Any], wishes: Wishes, file: str
) -> Variant:
    """The architecture that tensors of these names and shapes belong to.

    Raises:
      WeightsError: If a size is not clear, or the network is not the expected or a published one.
      ConfigError: If the expected variant does not exist.
    """
    expected = None if wishes.variant is None else get_variant(wishes.variant)
    tensors = named.tensors
    width = _shape(tensors, "cls_token", 3, file)[2]
    patch_px = _shape(tensors, "patch_embed.weight", 4, file)[3]
    numbers = [int(m[1]) for name in tensors if (m := re.match(r"blocks\.(\d+)\.", name))]
    if not numbers:
        raise WeightsError(f"'{file}' holds no blocks; it is no complete network")
    family = _family(tensors)
    has_registers = "registers" in tensors
    heads = _heads(tensors, family, width, wishes, config, file)
    hidden, mlp = _mlp(tensors, file)
    variant = Variant(
        name=CUSTOM,
        family=family,
        width=width,
        depth=1 + max(numbers),
        heads=heads,
        patch_px=patch_px,
        hidden=hidden,
        mlp=mlp,
        registers=_shape(tensors, "registers", 3, file)[1] if has_registers else 0,
        qkv_bias=_qkv_bias(tensors, family),
        position=_position(family, has_registers, named, wishes),  # pyright: ignore[reportArgumentType]
        table_side=0 if family == "dinov3" else _table_side(tensors, file),
        layer_scale=family != "dino",
        norm_eps=_norm_eps(family, wishes, config),
        cls_norm="cls_norm.weight" in tensors,
    )
    where = f"'{file}' and the configuration beside it"
    variant = check(dataclasses.asdict(variant), Variant, where, refused=WeightsError)
    variant.check()
    _check_config(variant, config, file)
    variant = dataclasses.replace(variant, name=_name(variant, named, wishes, file))
    if expected is not None and variant.name != expected.name:
        raise WeightsError(
            f"'{file}' does not hold '{expected.name}' but "
            + (f"'{variant.name}'" if variant.name != CUSTOM else "a network of its own")
            + _differences(variant, expected)
        )
    if variant.name == CUSTOM and not wishes.custom:
        closest = min(VARIANTS.values(), key=lambda known: len(_differing(variant, known)))
        raise WeightsError(
            f"'{file}' holds none of the published networks; the closest is '{closest.name}'"
            + _differences(variant, closest)
            + "; if that is meant, allow it with --custom"
        )
    return variant


def _shape(tensors: Mapping[str, StoredTensor], name: str, ndim: int, file: str) -> tuple[int, ...]:
    if name not in tensors:
        raise WeightsError(f"'{file}' holds no '{name}', without which no network is recognized")
    shape = tensors[name].shape
    if len(shape) != ndim or 0 in shape:
        raise WeightsError(f"'{name}' in '{file}' has shape {shape}; it must have {ndim} axes")
    return shape


def _family(tensors: Mapping[str, StoredTensor]) -> Family:
    if "positions" not in tensors:
        return "dinov3"
    return "dinov2" if any(name.endswith(".scale1") for name in tensors) else "dino"


def _heads(
    tensors: Mapping[str, StoredTensor],
    family: Family,
    width: int,
    wishes: Wishes,
    config: Mapping[str, Any],
    file: str,
) -> int:
    """From the caller, the configuration, the rotary periods or the rule of the published ones."""
    if wishes.heads is not None:
        return wishes.heads
    if isinstance(config.get("num_attention_heads"), int):
        return config["num_attention_heads"]
    head_width = _WIDE_HEAD_WIDTH if (family, width) == ("dinov3", _WIDE) else _HEAD_WIDTH
    if "periods" in tensors:
        head_width = 4 * _shape(tensors, "periods", 1, file)[0]
    if width % head_width:
        raise WeightsError(
            f"no tensor of '{file}' tells the number of heads, and a width of {width} is no "
            f"multiple of {head_width}; give it with --heads"
        )
    return width // head_width


def _mlp(tensors: Mapping[str, StoredTensor], file: str) -> tuple[int, Any]:
    """Hidden width and kind."""
    fused, gate, up = (f"blocks.0.{name}.weight" for name in ("gate_and_up", "gate", "up"))
    if fused in tensors:
        return _shape(tensors, fused, 2, file)[0] // 2, "swiglu"
    return _shape(tensors, up, 2, file)[0], "swiglu" if gate in tensors else "gelu"


def _qkv_bias(tensors: Mapping[str, StoredTensor], family: Family) -> Any:
    if not any(re.fullmatch(r"blocks\.\d+\.(qkv|q|v)\.bias", name) for name in tensors):
        return "none"
    return "no key" if family == "dinov3" else "all"


def _table_side(tensors: Mapping[str, StoredTensor], file: str) -> int:
    rows = _shape(tensors, "positions", 3, file)[1] - 1
    side = math.isqrt(rows)
    if side * side != rows:
        raise WeightsError(f"the position table of '{file}' has {rows} patches, which is no square")
    return side


def _position(family: Family, has_registers: bool, named: NamedTensors, wishes: Wishes) -> str:
    """Where the published implementations disagree, that of the file's layout."""
    if family == "dinov3":
        return "rotary"
    if has_registers:
        return "antialias"
    return wishes.position or ("offset" if named.layout.is_official else "size")


def _norm_eps(family: Family, wishes: Wishes, config: Mapping[str, Any]) -> Any:
    """The published one, or what the configuration of a network of its own says."""
    published = 1e-5 if family == "dinov3" else 1e-6
    is_own = wishes.custom and wishes.variant is None
    return config.get("layer_norm_eps", published) if is_own else published


def _name(variant: Variant, named: NamedTensors, wishes: Wishes, file: str) -> str:
    """The published name; of DINO v1, whose tensors any plain transformer has, only if wished."""
    name = name_of(variant)
    if variant.family != "dino" or name == CUSTOM:
        return name
    if wishes.variant is None and wishes.custom:
        return CUSTOM
    if wishes.variant is None:
        raise WeightsError(
            f"'{file}' has the tensors of '{name}', but so has any plain transformer of its size; "
            f"say --variant {name} if it is that network, or --custom if it is another"
        )
    if classifier := [key for key in named.dropped if re.fullmatch(_CLASSIFIER, key)]:
        raise WeightsError(
            f"'{file}' holds a classifier ('{classifier[0]}'), which '{name}' has not; convert it "
            "with --custom instead of --variant"
        )
    return name


def _check_config(variant: Variant, config: Mapping[str, Any], file: str) -> None:
    """Raises a `WeightsError` if Hugging Face's configuration says otherwise."""
    said: dict[str, Any] = {
        "num_attention_heads": variant.heads,
        "hidden_size": variant.width,
        "num_hidden_layers": variant.depth,
        "patch_size": variant.patch_px,
        "do_rescale": True,
        "rescale_factor": 1 / 255,
        "do_normalize": True,
        "image_mean": MEAN.tolist(),
        "image_std": STD.tolist(),
    }
    if variant.position == "rotary":
        said["rope_theta"] = ROTARY_BASE
    if variant.family != "dino":  # the port of the authors' 1e-6 says 1e-12
        said["layer_norm_eps"] = variant.norm_eps
    if (variant.family, variant.mlp) != ("dinov2", "swiglu"):  # it says gelu, which is not asked
        said["hidden_act"] = "silu" if variant.mlp == "swiglu" else "gelu"
    nested = config.get("rope_parameters")  # as of transformers 5
    config = {**config, **nested} if isinstance(nested, dict) else config
    for key, value in said.items():
        if key in config and _rounded(config[key]) != _rounded(value):
            raise WeightsError(
                f"the configuration beside '{file}' says {key} {config[key]}, not "
                f"{_rounded(value)}; give that of these weights, or a network that is computed so"
            )


def _rounded(value: Any) -> Any:
    """Numbers as configurations write them, to six digits."""
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    return round(value, 6) if isinstance(value, float) else value


def _differing(variant: Variant, known: Variant) -> list[str]:
    fields = ("family", *_SHOWN, "table_side", "cls_norm")
    return [name for name in fields if getattr(variant, name) != getattr(known, name)]


def _differences(variant: Variant, known: Variant) -> str:
    differences = [
        f"{name} {getattr(variant, name)} instead of {getattr(known, name)}"
        for name in _differing(variant, known)
    ]
    return f" ({', '.join(differences)})" if differences else ""
