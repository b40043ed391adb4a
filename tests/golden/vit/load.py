"""Golden networks: their weights, rebuilt from formulas, and what the official code makes of them.

Recorded with PyTorch 2.13 from the official code of the three families (float32, CPU) and from
Hugging Face's ports (`hf_*`), with deterministic weights in which every parameter matters. Keys of
a file: `<height>x<width>/` + `cls`, `registers`, `patches` (rows `patch_index`) after the final
norm; `stages` (mean, root mean square, projection of the stream before and after each block);
`attention_cls` (last block, row of cls); `attention_mean` (mean over blocks and heads, patches to
patches); `attention_heads` (the same per head); `bf16periods_*` with rounded rotary periods.
`pos_interp.npz`: tables resampled by three rules; `rope.npz`: rotary tables.
"""

import dataclasses
import inspect
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tests.golden.vit import weights as formulas

ROOT = Path(__file__).parent
TINY = (
    "dinov3_tiny_mlp",
    "dinov3_tiny_swiglu",
    "dinov3_tiny_7b",
    "dinov2_tiny",
    "dinov2_tiny_reg",
    "dinov2_tiny_swiglu",
    "dino_tiny",
    "dino_tiny_p8",
)


@dataclasses.dataclass(frozen=True)
class Network:
    """One golden file."""

    stem: str
    config: Mapping[str, Any]
    arrays: Mapping[str, np.ndarray]

    @property
    def sizes(self) -> list[str]:
        """`<height>x<width>` of the recorded images."""
        return sorted({key.split("/")[0] for key in self.arrays if "/" in key})

    def image(self, size: str) -> np.ndarray:
        """Normalised `[1, H, W, 3]`."""
        height, width = map(int, size.split("x"))
        planes = formulas.image(f"{self.stem}.{size}", height, width)
        return planes.transpose(0, 2, 3, 1)

    def official(self, rounded_periods: bool = False) -> dict[str, np.ndarray]:
        """All tensors under official names, buffers included."""
        c = self.config
        names = inspect.signature(formulas.official_shapes).parameters
        shapes = formulas.official_shapes(**{name: c[name] for name in names if name in c})
        tensors = formulas.state_dict(shapes)
        for key in shapes:
            if key.endswith("periods"):
                head_width = c["width"] // c["heads"]
                tensors[key] = formulas.periods(head_width, 100.0, rounded_periods)
            elif key.endswith("bias_mask"):
                tensors[key] = np.repeat(np.float32([1, 0, 1]), c["width"])
        return tensors


def load(stem: str) -> Network:
    """Reads a golden file."""
    with np.load(ROOT / f"{stem}.npz") as stored:
        arrays = {key: stored[key] for key in stored.files}
    return Network(stem, json.loads(str(arrays.pop("config"))), arrays)
