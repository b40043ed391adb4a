"""Largest difference of every published network from Hugging Face's, with random weights.

    python benchmarks/vit_agreement.py --torch-python PYTHON [NAMES ...] [--blocks N] [--json OUT]

The weights go through the converter. Bars: 1e-4 in float32 beside PyTorch's float32; cosine 0.9995
in bfloat16, the least over patches, beside PyTorch's float64. What PyTorch itself loses in float32
and in bfloat16 stands next to it. S is compared at 640x368 and 1280x720 too, all others at a small
size that is not square. `--blocks` leaves out all but the first: the 7B network fits no small
machine.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from remind_jax.backbone.vit import Numerics, encode
from remind_jax.backbone.vit_backbone import choose_attention
from remind_jax.backbone.vit_variants import VARIANTS, Variant
from remind_jax.backbone.vit_weights import load_weights
from weights_convert.conversion import convert
from weights_convert.variant_detection import Wishes

SMALL_PATCHES = (6, 9)  # rows, columns
LARGE = {"dinov3-vits16": ("640x368", "1280x720")}


def compare(
    published: Variant, torch_python: str, blocks: int | None = None
) -> list[dict[str, Any]]:
    """One row per size; of so many blocks, or all."""
    variant = dataclasses.replace(published, depth=blocks or published.depth)
    is_whole = variant == published
    rows, columns = (count * variant.patch_px for count in SMALL_PATCHES)
    sizes = (f"{columns}x{rows}", *LARGE.get(variant.name, ()))
    numbers = (variant.width, variant.depth, variant.heads, variant.patch_px, variant.hidden)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        words = [variant.name, variant.family, *map(str, numbers), variant.mlp]
        words += [str(variant.registers), str(variant.table_side), *sizes]
        script = Path(__file__).with_name("vit_reference.py")
        quiet = {**os.environ, "TRANSFORMERS_VERBOSITY": "error"}
        subprocess.run([torch_python, script, folder, *words], check=True, env=quiet)
        out = folder / "converted" / "ours.safetensors"
        start = time.perf_counter()
        wishes = Wishes(published.name if is_whole else None, custom=not is_whole)
        done = convert(folder, out, wishes=wishes)
        converted_s = time.perf_counter() - start
        assert done.variant.depth == variant.depth
        assert is_whole == (done.variant.name == published.name)
        start = time.perf_counter()
        weights = load_weights(out)
        loaded_s = time.perf_counter() - start
        times = {"convert_s": converted_s, "load_s": loaded_s}
        named = dataclasses.replace(weights.variant, name=published.name)
        return [difference(weights.params, named, folder, size) | times for size in sizes]


def difference(params: Any, variant: Variant, folder: Path, size: str) -> dict[str, Any]:
    """Ours and the reference on one image."""
    stored = np.load(folder / f"{size}.npz")
    image = stored["image"].transpose(0, 2, 3, 1)
    num_patches = math.prod(s // variant.patch_px for s in image.shape[1:3])
    method = choose_attention(variant, variant.num_prefix + num_patches, "cpu")

    def patches(dtype: Any) -> np.ndarray:
        numerics = Numerics(dtype, method)
        tokens = jax.jit(lambda p, x: encode(p, x, variant, numerics))(params, image)
        return np.asarray(tokens.patches, np.float64).reshape(-1, variant.width)

    exact, rounded = patches(jnp.float32), patches(jnp.bfloat16)
    kinds = ("tokens", "tokens_float64", "tokens_bfloat16")
    peer, truth, peer_rounded = (stored[k][0, -num_patches:].astype(np.float64) for k in kinds)
    ours, theirs = cosines(rounded, truth), cosines(peer_rounded, truth)
    return {
        "name": f"{variant.name} {size} {variant.depth} blocks",
        "max_abs_difference": float(np.abs(exact - peer).max()),
        "ours_from_float64": float(np.abs(exact - truth).max()),
        "peer_from_float64": float(np.abs(peer - truth).max()),
        "bfloat16_min_cosine": float(ours.min()),
        "bfloat16_mean_cosine": float(ours.mean()),
        "peer_bfloat16_min_cosine": float(theirs.min()),
        "rms": float(np.sqrt((truth**2).mean())),
    }


def cosines(some: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Of every pair of rows."""
    lengths = np.linalg.norm(some, axis=1) * np.linalg.norm(others, axis=1)
    return (some * others).sum(1) / lengths


def main() -> None:
    """Compares all networks that were asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", help="all but the 7B one if left out")
    parser.add_argument("--torch-python", default=os.environ.get("TORCH_PYTHON"), required=False)
    parser.add_argument("--blocks", type=int, help="only the first; all if left out")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    if not args.torch_python:
        raise SystemExit("name a Python with torch and transformers: --torch-python")
    found = []
    for name in args.names or [name for name in VARIANTS if "7b" not in name]:
        for row in compare(VARIANTS[name], args.torch_python, args.blocks):
            found.append(row)
            print(
                f"{row['name']:40} float32 {row['max_abs_difference']:.1e}"
                f" (from float64: ours {row['ours_from_float64']:.1e}, PyTorch's"
                f" {row['peer_from_float64']:.1e})"
                f"  bfloat16 cosine {row['bfloat16_min_cosine']:.5f}"
                f" mean {row['bfloat16_mean_cosine']:.5f}"
                f" (PyTorch's {row['peer_bfloat16_min_cosine']:.5f})"
                f"  convert {row['convert_s']:.1f} s  load {row['load_s']:.2f} s",
                flush=True,
            )
    if args.json:
        args.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
