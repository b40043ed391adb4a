"""Stand-ins with the attributes and shapes that detectors publish; none of them is installed."""

from __future__ import annotations

import types
from typing import Any

import numpy as np


class Tensor:
    """Looks like a tensor of PyTorch, on the host or on a device that NumPy cannot read."""

    def __init__(self, values: Any, device: str = "cpu", requires_grad: bool = False):
        self.values, self.device, self.requires_grad = np.asarray(values), device, requires_grad
        self.shape = self.values.shape

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, at: Any) -> Tensor:
        return Tensor(self.values[at], self.device, self.requires_grad)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        if self.device != "cpu":
            raise TypeError(
                f"can't convert {self.device} device type tensor to numpy. Use Tensor.cpu() to "
                "copy the tensor to host memory first."
            )
        if self.requires_grad:
            raise RuntimeError("Can't call numpy() on Tensor that requires grad.")
        return self.values if dtype is None else self.values.astype(dtype)

    def __dlpack_device__(self) -> tuple[int, int]:
        return (1 if self.device == "cpu" else 2), 0

    def __dlpack__(self, **options: Any) -> Any:
        if self.device != "cpu":
            raise BufferError("the data are on a device")
        return self.values.__dlpack__(**options)

    def detach(self) -> Tensor:
        return Tensor(self.values, self.device)

    def cpu(self) -> Tensor:
        return Tensor(self.values)


class DLPackOnly:
    """An array of a library that knows nothing but DLPack."""

    def __init__(self, values: np.ndarray, kind: int = 1):
        self._values, self._kind = values, kind

    def __dlpack_device__(self) -> tuple[int, int]:
        return self._kind, 0

    def __dlpack__(self, **options: Any) -> Any:
        if self._kind != 1:
            raise BufferError("the data are on a device")
        return self._values.__dlpack__(**options)


def ultralytics_results(
    frame_size: tuple[int, int], boxes: Any, planes: Any = None, classes: Any = None
) -> types.SimpleNamespace:
    """`Results` of a YOLO: boxes [N, 4], planes over the network's input."""
    boxes = np.asarray(boxes, np.float32).reshape(-1, 4)
    classes = np.zeros(len(boxes)) if classes is None else np.asarray(classes)
    found = types.SimpleNamespace(
        xyxy=Tensor(boxes),
        conf=Tensor(np.linspace(0.9, 0.5, len(boxes), dtype=np.float32)),
        cls=Tensor(classes.astype(np.float32)),
    )
    masks = None if planes is None else types.SimpleNamespace(data=Tensor(planes))
    return types.SimpleNamespace(
        boxes=found, masks=masks, names={0: "cup", 1: "tv"}, orig_shape=frame_size, probs=None
    )


def sam_masks(planes: Any, estimates: Any = None) -> list[dict[str, Any]]:
    """What the generators of automatic masks of SAM and SAM 2 give for a picture."""
    planes = np.asarray(planes, bool)
    estimates = [0.9] * len(planes) if estimates is None else estimates
    return [
        {"segmentation": plane, "area": int(plane.sum()), "predicted_iou": estimate}
        for plane, estimate in zip(planes, estimates, strict=True)
    ]
