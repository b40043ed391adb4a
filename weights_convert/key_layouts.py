"""The key layouts of published weight files, brought to one vocabulary.

Rule: backbones.md#weight-files. Keys are matched as a whole, never replaced in part.

Vocabulary: `cls_token registers positions periods patch_embed.* norm.* cls_norm.*`, and for every
block `i`: `blocks.i.` + `norm1.* norm2.* qkv.* q.* k.* v.* proj.* scale1 scale2 up.* down.* gate.*
gate_and_up.*`, where `*` is `weight` or `bias` (`qkv.bias_mask` too). Tensors keep their published
shapes.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from typing import Any

from remind_jax.errors import WeightsError
from weights_convert.stored_tensors import StoredTensor

_WB = r"(weight|bias)"
_ROLES = ("teacher", "student", "model", "state_dict", "model_state_dict")  # best first
_PREFIXES = ("module.", "backbone.", "dinov2_with_registers.", "dinov2.", "vit.", "teacher.")


def _blocks(prefix: str, table: Mapping[str, str]) -> dict[str, str]:
    return {rf"{prefix}(\d+)\.{pattern}": rf"blocks.\1.{name}" for pattern, name in table.items()}


_OFFICIAL = {
    r"cls_token": "cls_token",
    r"(?:storage|register)_tokens": "registers",
    r"pos_embed": "positions",
    r"rope_embed\.periods": "periods",
    rf"patch_embed\.proj\.{_WB}": r"patch_embed.\1",
    rf"(norm|cls_norm)\.{_WB}": r"\1.\2",
    # Training checkpoints of DINOv2 hold blocks in chunks; the second number counts on.
    **_blocks(
        r"blocks\.(?:\d+\.)?",
        {
            rf"norm([12])\.{_WB}": r"norm\2.\3",
            r"attn\.qkv\.(weight|bias|bias_mask)": r"qkv.\2",
            rf"attn\.proj\.{_WB}": r"proj.\2",
            r"ls([12])\.gamma": r"scale\2",
            rf"mlp\.fc1\.{_WB}": r"up.\2",
            rf"mlp\.fc2\.{_WB}": r"down.\2",
            rf"mlp\.w1\.{_WB}": r"gate.\2",
            rf"mlp\.w2\.{_WB}": r"up.\2",
            rf"mlp\.w3\.{_WB}": r"down.\2",
            rf"mlp\.w12\.{_WB}": r"gate_and_up.\2",
        },
    ),
}

_HF_EMBEDDINGS = {
    r"embeddings\.cls_token": "cls_token",
    r"embeddings\.register_tokens": "registers",
    r"embeddings\.position_embeddings": "positions",
}

_HF_DINOV3 = {
    **_HF_EMBEDDINGS,
    rf"embeddings\.patch_embeddings\.{_WB}": r"patch_embed.\1",
    rf"norm\.{_WB}": r"norm.\1",
    **_blocks(
        r"layer\.",
        {
            rf"norm([12])\.{_WB}": r"norm\2.\3",
            rf"attention\.([qkv])_proj\.{_WB}": r"\2.\3",
            rf"attention\.o_proj\.{_WB}": r"proj.\2",
            r"layer_scale([12])\.lambda1": r"scale\2",
            rf"mlp\.(up|down|gate)_proj\.{_WB}": r"\2.\3",
        },
    ),
}

# In files, and in memory of transformers 5 where that differs.
_HF_DINOV2_AND_DINO = {
    **_HF_EMBEDDINGS,
    rf"embeddings\.patch_embeddings\.projection\.{_WB}": r"patch_embed.\1",
    rf"layernorm\.{_WB}": r"norm.\1",
    **_blocks(
        r"(?:encoder\.)?layers?\.",
        {
            rf"norm([12])\.{_WB}": r"norm\2.\3",
            rf"layernorm_before\.{_WB}": r"norm1.\2",
            rf"layernorm_after\.{_WB}": r"norm2.\2",
            rf"attention\.attention\.query\.{_WB}": r"q.\2",
            rf"attention\.attention\.key\.{_WB}": r"k.\2",
            rf"attention\.attention\.value\.{_WB}": r"v.\2",
            rf"attention\.([qkv])_proj\.{_WB}": r"\2.\3",
            rf"attention\.(?:output\.dense|o_proj)\.{_WB}": r"proj.\2",
            r"layer_scale([12])\.lambda1": r"scale\2",
            rf"(?:mlp\.fc1|intermediate\.dense)\.{_WB}": r"up.\2",
            rf"(?:mlp\.fc2|output\.dense)\.{_WB}": r"down.\2",
            rf"mlp\.weights_in\.{_WB}": r"gate_and_up.\2",
            rf"mlp\.weights_out\.{_WB}": r"down.\2",
            rf"mlp\.(up|down|gate)_proj\.{_WB}": r"\2.\3",
        },
    ),
}

# What no model needs that only looks: dropped without a word, or with one.
_SILENT = r"(.*\.)?(mask_token|inv_freq)"
_NOTED = r"(local_cls_norm|head|classifier|dino_head|ibot_head|pooler)\..*|optimizer.*"


@dataclasses.dataclass(frozen=True)
class Layout:
    """One way of naming tensors."""

    name: str
    is_official: bool
    evidence: str  # a key that only this layout has
    table: Mapping[str, str]  # regular expression of a whole key -> our name


LAYOUTS = (
    Layout("official .pth", True, "patch_embed.proj.weight", _OFFICIAL),
    Layout("Hugging Face DINOv3", False, "embeddings.patch_embeddings.weight", _HF_DINOV3),
    Layout(
        "Hugging Face DINOv2 or DINO",
        False,
        "embeddings.patch_embeddings.projection.weight",
        _HF_DINOV2_AND_DINO,
    ),
)


@dataclasses.dataclass(frozen=True)
class NamedTensors:
    """Tensors under our names, and what became of the other keys."""

    layout: Layout
    tensors: Mapping[str, StoredTensor]  # by our name
    source_keys: Mapping[str, str]  # our name -> key in the file
    unexpected: tuple[str, ...]  # keys of the file without a place
    dropped: tuple[str, ...]  # keys that only training needs


def name_tensors(tensors: Mapping[str, Any], file: str) -> NamedTensors:
    """Names tensors in our words. Raises WeightsError if no layout fits, or two keys mean one."""
    flat = _strip(_unwrap(tensors), file)
    layout = next((known for known in LAYOUTS if known.evidence in flat), None)
    if layout is None:
        known = "; ".join(f"{known.name} ('{known.evidence}')" for known in LAYOUTS)
        some = ", ".join(list(flat)[:4]) or "none"
        raise WeightsError(
            f"'{file}' has no known key layout, which are: {known}; its first keys are: {some}"
        )
    named: dict[str, str] = {}
    unexpected, dropped = [], []
    for key in flat:
        name = _translate(key, layout.table)
        if name in named:
            raise WeightsError(f"'{file}' holds '{name}' twice: '{named[name]}' and '{key}'")
        if name is not None:
            named[name] = key
        elif re.fullmatch(_NOTED, key):
            dropped.append(key)
        elif not re.fullmatch(_SILENT, key):
            unexpected.append(key)
    found = {name: flat[key] for name, key in named.items()}
    return NamedTensors(layout, found, named, tuple(unexpected), tuple(dropped))


def _unwrap(tensors: Mapping[str, Any]) -> Mapping[str, Any]:
    """The network of a checkpoint that the published features come from."""
    for role in _ROLES:
        if isinstance(tensors.get(role), Mapping):
            return _unwrap(tensors[role])
    return {key: value for key, value in tensors.items() if isinstance(value, StoredTensor)}


def _strip(tensors: Mapping[str, StoredTensor], file: str) -> dict[str, StoredTensor]:
    """Takes off what wrappers put in front of keys."""
    stripped: dict[str, StoredTensor] = {}
    for key, tensor in tensors.items():
        short, before = key, ""
        while short != before:
            before = short
            for prefix in (*_PREFIXES, "model."):
                short = short.removeprefix(prefix)
        if short in stripped:
            raise WeightsError(f"'{file}' holds '{short}' twice, under different prefixes")
        stripped[short] = tensor
    return stripped


def _translate(key: str, table: Mapping[str, str]) -> str | None:
    for pattern, name in table.items():
        if match := re.fullmatch(pattern, key):
            return match.expand(name)
    return None
