"""Official tensors under Hugging Face's names, written out apart from the converter's tables."""

import functools

import numpy as np

Tensors = dict[str, np.ndarray]


def as_hugging_face(official: Tensors, family: str, copied: bool = True) -> Tensors:
    """The file that Hugging Face publishes for the same network; views if nothing is copied."""
    rename = {
        "dinov3": _dinov3,
        "dinov2": functools.partial(_dinov2_or_dino, inner_names=_DINOV2_INNER),
        "dino": functools.partial(_dinov2_or_dino, inner_names=_DINO_INNER),
    }[family]
    out: Tensors = {}
    for key, value in official.items():
        if key.endswith(("periods", "bias_mask")) or key.startswith("local_cls_norm"):
            continue
        if key == "mask_token":
            out["embeddings.mask_token"] = value[None] if family == "dinov3" else value
            continue
        for name, part in _split(key, value):
            if family == "dinov3" and name.endswith("attn.k.bias"):
                continue
            out[rename(name)] = np.ascontiguousarray(part) if copied else part
    return out


def _split(key: str, value: np.ndarray) -> list[tuple[str, np.ndarray]]:
    if ".attn.qkv." not in key:
        return [(key, value)]
    parts = np.split(value, 3)
    return [(key.replace("qkv", name), part) for name, part in zip("qkv", parts, strict=True)]


def _block(name: str) -> tuple[str, str]:
    _, number, rest = name.split(".", 2)
    return number, rest


def _dinov3(name: str) -> str:
    outer = {
        "cls_token": "embeddings.cls_token",
        "storage_tokens": "embeddings.register_tokens",
        "patch_embed.proj.weight": "embeddings.patch_embeddings.weight",
        "patch_embed.proj.bias": "embeddings.patch_embeddings.bias",
    }
    if not name.startswith("blocks."):
        return outer.get(name, name)
    number, rest = _block(name)
    inner, _, kind = rest.rpartition(".")
    new = {
        "attn.q": "attention.q_proj",
        "attn.k": "attention.k_proj",
        "attn.v": "attention.v_proj",
        "attn.proj": "attention.o_proj",
        "mlp.fc1": "mlp.up_proj",
        "mlp.fc2": "mlp.down_proj",
        "mlp.w1": "mlp.gate_proj",
        "mlp.w2": "mlp.up_proj",
        "mlp.w3": "mlp.down_proj",
        "ls1": "layer_scale1",
        "ls2": "layer_scale2",
    }.get(inner, inner)
    return f"layer.{number}.{new}.{kind.replace('gamma', 'lambda1')}"


_HF_OUTER = {
    "cls_token": "embeddings.cls_token",
    "pos_embed": "embeddings.position_embeddings",
    "register_tokens": "embeddings.register_tokens",
    "patch_embed.proj.weight": "embeddings.patch_embeddings.projection.weight",
    "patch_embed.proj.bias": "embeddings.patch_embeddings.projection.bias",
    "norm.weight": "layernorm.weight",
    "norm.bias": "layernorm.bias",
}
_HF_INNER = {
    "attn.q": "attention.attention.query",
    "attn.k": "attention.attention.key",
    "attn.v": "attention.attention.value",
    "attn.proj": "attention.output.dense",
}
_DINOV2_INNER = _HF_INNER | {
    "mlp.w12": "mlp.weights_in",
    "mlp.w3": "mlp.weights_out",
    "ls1": "layer_scale1",
    "ls2": "layer_scale2",
}
_DINO_INNER = _HF_INNER | {
    "norm1": "layernorm_before",
    "norm2": "layernorm_after",
    "mlp.fc1": "intermediate.dense",
    "mlp.fc2": "output.dense",
}


def _dinov2_or_dino(name: str, inner_names: dict[str, str]) -> str:
    if not name.startswith("blocks."):
        return _HF_OUTER[name]
    number, rest = _block(name)
    inner, _, kind = rest.rpartition(".")
    new = inner_names.get(inner, inner)
    return f"encoder.layer.{number}.{new}.{kind.replace('gamma', 'lambda1')}"
