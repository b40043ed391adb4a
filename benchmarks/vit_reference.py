"""Hugging Face's networks with random weights in which everything matters, and their outputs.

    vit_reference.py FOLDER NAME FAMILY WIDTH DEPTH HEADS PATCH HIDDEN MLP REGISTERS SIDE SIZE...

Runs in an environment with torch and transformers. Writes `model.safetensors`, `config.json`, and
for every SIZE (`WIDTHxHEIGHT`) the normalised input and the tokens: in float32, of the same weights
in float64, and of a model in bfloat16.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch  # pyright: ignore[reportMissingImports]
import transformers  # pyright: ignore[reportMissingImports]


def main() -> None:
    """Makes one network and runs it."""
    folder, name, family = Path(sys.argv[1]), sys.argv[2], sys.argv[3]
    numbers = [int(word) for word in (*sys.argv[4:9], *sys.argv[10:12])]
    torch.manual_seed(0)
    torch.set_num_threads(1)
    with torch.device("meta"):
        model = make_model(name, family, sys.argv[9], *numbers)
    model = model.to_empty(device="cpu").eval()
    with torch.no_grad():
        for key, parameter in model.named_parameters():
            parameter.copy_(draw(key, parameter.shape))
        for key, buffer in model.named_buffers():
            if "inv_freq" in key:
                head_width = numbers[0] // numbers[2]
                buffer.copy_(1 / 100 ** torch.arange(0, 1, 4 / head_width, dtype=torch.float32))
    model.save_pretrained(folder)
    options = {"interpolate_pos_encoding": True} if family == "dino" else {}
    sizes = [tuple(map(int, size.split("x"))) for size in sys.argv[12:]]
    images = [torch.randn(1, 3, height, width) for width, height in sizes]
    found: list[dict[str, Any]] = [{"image": image.numpy()} for image in images]

    def run(kind: str, dtype: Any) -> None:
        for results, image in zip(found, images, strict=True):
            with torch.inference_mode():
                tokens = model(image.to(dtype), **options).last_hidden_state
            results[kind] = tokens.to(torch.promote_types(dtype, torch.float32)).numpy()

    run("tokens", torch.float32)
    hooks = compute_in_float64(model)
    run("tokens_float64", torch.float64)
    for hook in hooks:
        hook.remove()
    model.to(torch.bfloat16)
    run("tokens_bfloat16", torch.bfloat16)
    for (width, height), results in zip(sizes, found, strict=True):
        np.savez(folder / f"{width}x{height}.npz", **results)


def compute_in_float64(model: Any) -> list[Any]:
    """Parts of a network become float64 while they run: all of it at once may not fit."""

    def widen(module: Any, inputs: tuple[Any, ...]) -> tuple[Any, ...]:
        module.double()
        return tuple(x.double() if torch.is_tensor(x) else x for x in inputs)

    def narrow(module: Any, *_: Any) -> None:
        module.float()

    blocks = next(m for m in model.modules() if isinstance(m, torch.nn.ModuleList))
    norm = model.norm if hasattr(model, "norm") else model.layernorm
    parts = [model.embeddings, *blocks, norm]
    return [
        hook
        for part in parts
        for hook in (part.register_forward_pre_hook(widen), part.register_forward_hook(narrow))
    ]


def make_model(name: str, family: str, mlp: str, *numbers: int) -> Any:
    """A network without weights."""
    width, depth, heads, patch, hidden, registers, side = numbers
    shared = {
        "hidden_size": width,
        "num_hidden_layers": depth,
        "num_attention_heads": heads,
        "patch_size": patch,
        "attn_implementation": "sdpa",
    }
    if family == "dinov3":
        has_bias = "7b" not in name
        return transformers.DINOv3ViTModel(
            transformers.DINOv3ViTConfig(
                **shared,
                intermediate_size=hidden,
                num_register_tokens=registers,
                use_gated_mlp=mlp == "swiglu",
                hidden_act="silu" if mlp == "swiglu" else "gelu",
                query_bias=has_bias,
                value_bias=has_bias,
            )
        )
    if family == "dinov2":
        options = {"image_size": side * patch, "use_swiglu_ffn": mlp == "swiglu"}
        if registers:
            return transformers.Dinov2WithRegistersModel(
                transformers.Dinov2WithRegistersConfig(
                    **shared, **options, num_register_tokens=registers
                )
            )
        return transformers.Dinov2Model(transformers.Dinov2Config(**shared, **options))
    config = transformers.ViTConfig(
        **shared, intermediate_size=hidden, image_size=side * patch, layer_norm_eps=1e-6
    )
    return transformers.ViTModel(config, add_pooling_layer=False)


def draw(key: str, shape: Any) -> Any:
    """Layer scales near one, norms, biases and tokens of that order, wide attention logits."""
    noise = 2 * torch.rand(shape) - 1
    if "norm" in key:
        return 1 + 0.3 * noise if key.endswith("weight") else 0.2 * noise
    if "lambda" in key:
        return 0.6 + 0.5 * noise
    if "token" in key or "position" in key:
        return 0.8 * noise
    if key.endswith("bias"):
        return 0.3 * noise
    wide = any(part in key for part in ("query", "key", "q_proj", "k_proj"))
    return (2.0 if wide else 1.2) * (3 / shape[1:].numel()) ** 0.5 * noise


if __name__ == "__main__":
    main()
