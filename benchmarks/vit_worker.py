"""One backend of `benchmarks/vit.py` in a process of its own: ours, or PyTorch's.

    vit_worker.py ours|torch WEIGHTS HEIGHT WIDTH BATCH DTYPE CORES

Answers every line on stdin with one line of JSON. Runs in the environment of its backend, which
need not know the other. Cores are chosen before anything starts threads.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np


def main() -> None:
    """Serves until stdin ends."""
    backend, weights, height, width, batch, dtype, cores = sys.argv[1:8]
    if int(cores):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: int(cores)])
    images = pictures(int(batch), int(height), int(width))
    make = {"ours": make_ours, "torch": make_torch}[backend]
    run, read, device = make(Path(weights), images, dtype, int(cores))
    answer({"device": device, "rss_mib": peak_mib()})
    result = None
    for line in sys.stdin:
        if line.strip() == "run":
            wall, cpu = time.perf_counter(), time.process_time()
            result = run()
            spent = 1000 * (time.perf_counter() - wall), 1000 * (time.process_time() - cpu)
            answer({"wall_ms": spent[0], "cpu_ms": spent[1], "rss_mib": peak_mib()})
        else:
            np.save(line.strip(), read(result))
            answer({})


def pictures(batch: int, height: int, width: int) -> np.ndarray:
    """Random blobs, uint8 RGB."""
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 256, (batch, height // 20 + 1, width // 20 + 1, 3))
    fine = np.repeat(np.repeat(coarse, 20, 1), 20, 2)[:, :height, :width]
    return np.clip(fine + rng.normal(0, 12, fine.shape), 0, 255).astype(np.uint8)


def peak_mib() -> float:
    """Largest resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def answer(values: dict[str, Any]) -> None:
    """One line for the parent."""
    print(json.dumps(values), flush=True)


def make_ours(
    weights: Path, images: np.ndarray, dtype: str, cores: int
) -> tuple[Callable[[], Any], Callable[[Any], np.ndarray], str]:
    """The backbone as users get it."""
    del cores
    import jax

    from remind_jax.backbone.registry import get_backbone

    backbone = get_backbone(f"vit:{weights}", precision=dtype)
    placed = jax.device_put(images)

    def run() -> Any:
        return jax.block_until_ready(backbone.extract(placed))

    return run, np.asarray, jax.devices()[0].device_kind


def make_torch(
    weights: Path, images: np.ndarray, dtype: str, cores: int
) -> tuple[Callable[[], Any], Callable[[Any], np.ndarray], str]:
    """Hugging Face's model of the same file with fused attention."""
    import torch  # pyright: ignore[reportMissingImports]
    from transformers import AutoModel  # pyright: ignore[reportMissingImports]

    if cores:
        torch.set_num_threads(cores)
    on_gpu = torch.cuda.is_available()
    device = "cuda" if on_gpu else "cpu"
    kind = {"float32": torch.float32, "bfloat16": torch.bfloat16}[dtype]
    model = AutoModel.from_pretrained(weights.parent, attn_implementation="sdpa", dtype=kind)
    model = model.eval().to(device)
    placed = torch.from_numpy(images).to(device)
    mean = torch.tensor([0.485, 0.456, 0.406], device=device)
    std = torch.tensor([0.229, 0.224, 0.225], device=device)

    @torch.inference_mode()
    def run() -> Any:
        pixels = (placed.to(torch.float32) * (1 / 255) - mean) / std
        tokens = model(pixels.permute(0, 3, 1, 2).to(kind)).last_hidden_state
        if on_gpu:
            torch.cuda.synchronize()
        return tokens

    def read(tokens: Any) -> np.ndarray:
        rows, columns = images.shape[1] // 16, images.shape[2] // 16
        patches = tokens[:, -rows * columns :].float().cpu().numpy()
        return patches.reshape(len(images), rows, columns, -1)

    return run, read, torch.cuda.get_device_name() if on_gpu else "cpu"


if __name__ == "__main__":
    main()
