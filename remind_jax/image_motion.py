"""How the whole image moved since the frame before (host, OpenCV).

Corners are followed by sparse optical flow and a similarity is fitted to them: the shift, the turn
and the zoom of the image, with a score of trust. Remembered places move along with it
(`remind_jax.plus`). Nothing here knows objects or masks.
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
from jaxtyping import Float, UInt8

WORKING_AREA_PX = 320 * 240  # images are reduced to this size, whatever that of the frame
MAX_CORNERS = 200
CORNER_QUALITY = 0.01  # of the strongest corner
CORNER_DISTANCE_PX = 7
FLOW_WINDOW_PX = 15
FLOW_LEVELS = 3  # pyramid levels above the image itself
MAX_RETURN_ERROR_PX = 1.0  # followed forth and back, a corner must come home
RANSAC_ERROR_PX = 3.0
MIN_CORNERS = 6
GOOD_SCORE = 0.5  # below, the search is repeated without a guess of the shift
MIN_PHASE_RESPONSE = 0.1


@dataclasses.dataclass(frozen=True)
class ImageMotion:
    """Where pixels of the frame before lie in this frame."""

    matrix: Float[np.ndarray, "2 3"]  # similarity, pixels to pixels
    score: float  # share of corners that agree with it, [0, 1]; 0: unknown

    @classmethod
    def unknown(cls) -> ImageMotion:
        """No motion and no trust in that."""
        return cls(np.eye(2, 3, dtype=np.float32), 0.0)


class MotionEstimator:
    """Compares every frame with the one before; not thread-safe."""

    def __init__(self) -> None:
        self._previous: UInt8[np.ndarray, "h w"] | None = None
        self._clahe = cv2.createCLAHE(clipLimit=2.0, tileGridSize=(8, 8))

    def follow(self, image: UInt8[np.ndarray, "H W 3"]) -> ImageMotion:
        """The motion from the last image given here to this one; unknown for the first."""
        height, width = image.shape[:2]
        scale = min(1.0, (WORKING_AREA_PX / (height * width)) ** 0.5)
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        if scale < 1.0:
            size = (max(1, round(width * scale)), max(1, round(height * scale)))
            grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        grey = self._clahe.apply(grey)
        previous, self._previous = self._previous, grey
        if previous is None or previous.shape != grey.shape:
            return ImageMotion.unknown()
        return estimate_motion(previous, grey, (width / grey.shape[1], height / grey.shape[0]))

    def forget(self) -> None:
        """The next image is the first of another sequence."""
        self._previous = None


def estimate_motion(
    previous: UInt8[np.ndarray, "h w"],
    current: UInt8[np.ndarray, "h w"],
    pixel_size: tuple[float, float] = (1.0, 1.0),
) -> ImageMotion:
    """Fits a similarity to corners that are followed from one grey image to the next.

    Args:
      previous: Grey image.
      current: Grey image of the same size.
      pixel_size: Width and height of a pixel of these images, in pixels of the frame.

    Returns:
      The motion in pixels of the frame.
    """
    shift, response = _correlate(previous, current)
    corners = cv2.goodFeaturesToTrack(previous, MAX_CORNERS, CORNER_QUALITY, CORNER_DISTANCE_PX)
    matrix, score = None, 0.0
    if corners is not None and len(corners) >= MIN_CORNERS:
        matrix, score = _fit(previous, current, corners, shift)
        if score < GOOD_SCORE:
            again, score_again = _fit(previous, current, corners, np.zeros(2, np.float32))
            if score_again > score:
                matrix, score = again, score_again
    if matrix is None:
        matrix = np.eye(2, 3, dtype=np.float32)
        if response > MIN_PHASE_RESPONSE:
            matrix[:, 2] = shift
        score = 0.0
    scaled = np.asarray(matrix, np.float32).copy()
    size = np.asarray(pixel_size, np.float32)
    scaled[:, :2] *= size[:, None] / size[None, :]
    scaled[:, 2] *= size
    return ImageMotion(scaled, float(score))


def _correlate(previous: np.ndarray, current: np.ndarray) -> tuple[np.ndarray, float]:
    """Shift by phase correlation at half the working size, and the height of its peak."""
    small = [
        cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA).astype(np.float32)
        for grey in (previous, current)
    ]
    window = cv2.createHanningWindow(small[0].shape[::-1], cv2.CV_32F)
    shift, response = cv2.phaseCorrelate(small[0], small[1], window)
    return 2 * np.asarray(shift, np.float32), float(response)


def _fit(
    previous: np.ndarray, current: np.ndarray, corners: np.ndarray, shift: np.ndarray
) -> tuple[np.ndarray | None, float]:
    """Follows corners from a guessed shift; the similarity and the share that agrees with it."""
    options = {
        "winSize": (FLOW_WINDOW_PX, FLOW_WINDOW_PX),
        "maxLevel": FLOW_LEVELS,
        "flags": cv2.OPTFLOW_USE_INITIAL_FLOW,
    }
    guess = (corners + shift).astype(np.float32)
    there, found, _ = cv2.calcOpticalFlowPyrLK(previous, current, corners, guess.copy(), **options)
    guess_back = (there - shift).astype(np.float32)
    back, returned, _ = cv2.calcOpticalFlowPyrLK(current, previous, there, guess_back, **options)
    error = np.linalg.norm((back - corners).reshape(-1, 2), axis=1)
    good = (found.ravel() == 1) & (returned.ravel() == 1) & (error < MAX_RETURN_ERROR_PX)
    if good.sum() < MIN_CORNERS:
        return None, 0.0
    matrix, inliers = cv2.estimateAffinePartial2D(
        corners[good], there[good], method=cv2.RANSAC, ransacReprojThreshold=RANSAC_ERROR_PX
    )
    if matrix is None:
        return None, 0.0
    return matrix.astype(np.float32), float(inliers.sum()) / len(corners)
