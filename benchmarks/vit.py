"""Time, memory and agreement of the vision transformer, beside PyTorch in the same run.

    python benchmarks/vit.py [--torch-python PYTHON] [--json OUT]     CPU, ViT-S/16
    python benchmarks/vit.py --models vits16 vitb16 vitl16 --sizes 1280x720 --batches 1 8 32 \
        --dtype bfloat16 --cores 0                                      where JAX finds a GPU

Both get the same random weights (layer scales near one, wide attention logits) and the same
images, in a process each, and take turns. The peer is Hugging Face's model of DINOv3 with fused
attention; it is looked for in the environment of `--torch-python` (or of the variable
TORCH_PYTHON), where `pip install torch transformers safetensors` has put it. Processes are pinned
to `--cores` cores; the time is CPU seconds for one core, which other programs disturb little, and
wall time for several. OpenMP waits passively: spinning on busy cores would make the peer slow.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import save_file

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from remind_jax.backbone.vit_variants import Variant, get_variant
from weights_convert.conversion import convert

# Of matrix products in bfloat16 without sparsity, by the maker's data sheets, in 1e12 per second.
PEAK_TFLOPS = {"H100": 989.0, "H200": 989.0, "A100": 312.0, "L4": 121.0, "4090": 165.0}
QUIET = {
    "OMP_WAIT_POLICY": "PASSIVE",
    "GOMP_SPINCOUNT": "0",
    "TRANSFORMERS_VERBOSITY": "error",
    "HF_HUB_OFFLINE": "1",
    "TF_CPP_MIN_LOG_LEVEL": "3",
}


class Worker:
    """One backend in its own process."""

    def __init__(self, python: str, backend: str, weights: Path, args: list[str], cores: int):
        settings = {**os.environ, **QUIET}
        if cores:
            settings["OMP_NUM_THREADS"] = str(cores)
        self._process = subprocess.Popen(
            [python, str(Path(__file__).with_name("vit_worker.py")), backend, str(weights), *args],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=settings,
            cwd=Path(__file__).resolve().parent.parent,
        )
        self.start = self._read()

    def run(self) -> dict[str, float]:
        """One forward pass: its times in ms and the peak memory so far in MiB."""
        return self._ask("run")

    def output(self, path: Path) -> np.ndarray:
        """Patch features of the last pass."""
        self._ask(str(path))
        return np.load(path)

    def close(self) -> None:
        """Ends the process."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()

    def _ask(self, line: str) -> dict[str, Any]:
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()
        return self._read()

    def _read(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit("a backend stopped; its message stands above")
        return json.loads(line)


def write_model(folder: Path, variant: Variant, seed: int = 0) -> Path:
    """Random weights in Hugging Face's layout of DINOv3, and converted; returns our file."""
    rng = np.random.default_rng(seed)
    d, hidden = variant.width, variant.hidden

    def tensor(*shape: int, scale: float = 0.0, around: float = 0.0) -> np.ndarray:
        spread = scale or 1.2 * (3 / np.prod(shape[1:])) ** 0.5
        return (around + spread * rng.uniform(-1, 1, shape)).astype(np.float32)

    tensors = {
        "embeddings.cls_token": tensor(1, 1, d, scale=1.0),
        "embeddings.mask_token": np.zeros((1, 1, d), np.float32),
        "embeddings.register_tokens": tensor(1, variant.registers, d, scale=1.0),
        "embeddings.patch_embeddings.weight": tensor(d, 3, variant.patch_px, variant.patch_px),
        "embeddings.patch_embeddings.bias": tensor(d, scale=0.3),
        "norm.weight": tensor(d, scale=0.3, around=1.0),
        "norm.bias": tensor(d, scale=0.2),
    }
    gated = {"gate_proj": (hidden, d)} if variant.mlp == "swiglu" else {}
    matrices = {**gated, "up_proj": (hidden, d), "down_proj": (d, hidden)}
    for i in range(variant.depth):
        block: dict[str, np.ndarray] = {}
        for part in "qkvo":
            gain = 2.0 if part in "qk" else 1.2
            block[f"attention.{part}_proj.weight"] = tensor(d, d, scale=gain * (3 / d) ** 0.5)
            if part != "k" and (part == "o" or variant.qkv_bias != "none"):
                block[f"attention.{part}_proj.bias"] = tensor(d, scale=0.3)
        for name, shape in matrices.items():
            block[f"mlp.{name}.weight"] = tensor(*shape)
            block[f"mlp.{name}.bias"] = tensor(shape[0], scale=0.3)
        for number in (1, 2):
            block[f"norm{number}.weight"] = tensor(d, scale=0.3, around=1.0)
            block[f"norm{number}.bias"] = tensor(d, scale=0.2)
            block[f"layer_scale{number}.lambda1"] = tensor(d, scale=0.5, around=0.6)
        tensors |= {f"layer.{i}.{name}": values for name, values in block.items()}
    source = folder / "hf"
    source.mkdir(parents=True)
    save_file(tensors, source / "model.safetensors", metadata={"format": "pt"})
    config = {
        "model_type": "dinov3_vit",
        "architectures": ["DINOv3ViTModel"],
        "hidden_size": d,
        "num_hidden_layers": variant.depth,
        "num_attention_heads": variant.heads,
        "intermediate_size": hidden,
        "patch_size": variant.patch_px,
        "num_register_tokens": variant.registers,
        "query_bias": variant.qkv_bias != "none",
        "value_bias": variant.qkv_bias != "none",
        "key_bias": False,
        "use_gated_mlp": variant.mlp == "swiglu",
        "hidden_act": "silu" if variant.mlp == "swiglu" else "gelu",
        "layer_norm_eps": variant.norm_eps,
        "rope_theta": 100.0,
    }
    (source / "config.json").write_text(json.dumps(config))
    convert(source, source / "ours.converted.safetensors")
    return source / "ours.converted.safetensors"


def flops(variant: Variant, height: int, width: int) -> float:
    """Of the matrix products of one image."""
    num_patches = (height // variant.patch_px) * (width // variant.patch_px)
    num = variant.num_prefix + num_patches
    matrices = 3 if variant.mlp == "swiglu" else 2
    per_token = 4 * variant.width**2 + matrices * variant.width * variant.hidden
    attention = 2 * num**2 * variant.width
    embedding = num_patches * 3 * variant.patch_px**2 * variant.width
    return 2.0 * (variant.depth * (num * per_token + attention) + embedding)


def compare(
    name: str, variant: Variant, weights: Path, size: tuple[int, int], batch: int, args: Any
) -> dict[str, Any]:
    """One row: both backends in turns."""
    words = [*map(str, size), str(batch), args.dtype, str(args.cores)]
    ours = Worker(sys.executable, "ours", weights, words, args.cores)
    workers = {"ours": ours}
    if args.torch_python:
        workers["torch"] = Worker(args.torch_python, "torch", weights, words, args.cores)
    compile_ms = ours.run()["wall_ms"]
    first = {backend: worker.run() for backend, worker in workers.items()}
    del first
    kind = "cpu_ms" if args.cores == 1 else "wall_ms"
    runs = {backend: [] for backend in workers}
    for _ in range(args.repeats):
        for backend, worker in workers.items():
            runs[backend].append(worker.run())
    times = {b: statistics.median(run[kind] for run in done) for b, done in runs.items()}
    row: dict[str, Any] = {
        "name": name,
        "ours_ms": times["ours"],
        "peer": "PyTorch, fused attention",
        "peer_ms": times.get("torch"),
        "ratio": times["torch"] / times["ours"] if "torch" in times else None,
        "clock": kind,
        "first_call_ms": compile_ms,
        "ours_peak_mib": runs["ours"][-1]["rss_mib"],
        "ours_start_mib": ours.start["rss_mib"],
        "frames_per_s": 1000 * batch / times["ours"],
        "device": ours.start["device"],
    }
    with tempfile.TemporaryDirectory() as folder:
        outputs = {b: w.output(Path(folder) / f"{b}.npy") for b, w in workers.items()}
    if "torch" in workers:
        row["peer_peak_mib"] = runs["torch"][-1]["rss_mib"]
        row["max_abs_difference"] = float(np.abs(outputs["ours"] - outputs["torch"]).max())
        a, b = (outputs[k].reshape(-1, variant.width).astype(np.float64) for k in outputs)
        cosine = (a * b).sum(1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
        row["min_cosine"] = float(cosine.min())
    for device, peak in PEAK_TFLOPS.items():
        if device in ours.start["device"]:
            achieved = batch * flops(variant, *size) / times["ours"] / 1e9
            row["peak_fraction"] = achieved / peak
    for worker in workers.values():
        worker.close()
    return row


def show(row: dict[str, Any]) -> None:
    """Prints one row."""
    print(
        f"{row['name']:34} ours {row['ours_ms']:8.0f} ms"
        + (f"  PyTorch {row['peer_ms']:8.0f} ms  ratio {row['ratio']:.2f}" if row["ratio"] else "")
        + f"  ({row['clock']})  peak {row['ours_peak_mib']:.0f} MiB"
        + (f" / {row['peer_peak_mib']:.0f}" if row["ratio"] else "")
        + (f"  difference {row['max_abs_difference']:.1e}" if row["ratio"] else "")
        + (f"  min cosine {row['min_cosine']:.6f}" if row["ratio"] else "")
        + f"  first call {row['first_call_ms'] / 1000:.1f} s"
        + (f"  {row['frames_per_s']:.1f} frames/s")
        + (f"  {100 * row['peak_fraction']:.0f} % of peak" if "peak_fraction" in row else ""),
        flush=True,
    )


def main() -> None:
    """Compares all that was asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--torch-python", default=os.environ.get("TORCH_PYTHON"))
    parser.add_argument("--models", nargs="+", default=["vits16"])
    parser.add_argument("--sizes", nargs="+", default=["640x368", "1280x720"])
    parser.add_argument("--batches", nargs="+", type=int, default=[1])
    parser.add_argument("--dtype", choices=("float32", "bfloat16"), default="float32")
    parser.add_argument("--cores", type=int, default=1, help="0: leave them alone")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    rows = []
    for model in args.models:
        variant = get_variant(f"dinov3-{model}")
        with tempfile.TemporaryDirectory() as folder:
            weights = write_model(Path(folder), variant)
            for size in args.sizes:
                width, height = map(int, size.split("x"))
                for batch in args.batches:
                    name = f"{model} {size} x{batch} {args.dtype} {args.cores or 'all'} cores"
                    rows.append(compare(name, variant, weights, (height, width), batch, args))
                    show(rows[-1])
    if not args.torch_python:
        print("PyTorch: absent (no --torch-python)")
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
