"""How the whole image moved since the frame before (host, OpenCV).

Corners are followed by sparse optical flow and a similarity is fitted to them: the shift, the turn
and the zoom of the image, with a score of trust. Remembered places move along with it
(method_plus.md#image-motion). Nothing here knows objects or masks.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from remind_jax.plus.clock import TICK_S
from remind_jax.plus.observation import Motion

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
# Where light changes, pixels are compared by what is around them.
NORMALIZED_PX = 9  # side of what is around
NORMALIZED_SLACK = 6.0  # gray levels added to the spread
NORMALIZED_GAIN = 48.0  # gray levels per spread


def observe_motion(
    previous: UInt8[np.ndarray, "h w 3"] | None,
    image: UInt8[np.ndarray, "H W 3"] | None,
    elapsed_s: float | None = None,
) -> Motion:
    """The motion from one RGB image to the next; unknown without both, or if their sizes differ.

    Frames whose times are not known count as one tick each.
    """
    elapsed = 1.0 if elapsed_s is None else elapsed_s / TICK_S
    size = np.array((0, 0) if image is None else image.shape[:2], np.int32)
    if image is None or previous is None or previous.shape != image.shape:
        return _motion(np.eye(2, 3), 0.0, size, elapsed)
    matrix, score = estimate_motion(*(_reduce(frame) for frame in (previous, image)))
    height, width = reduced_size(image, WORKING_AREA_PX)
    pixel_size = image.shape[1] / width, image.shape[0] / height
    return _motion(scale_motion(matrix, pixel_size), score, size, elapsed)


def _motion(matrix: np.ndarray, score: float, size: np.ndarray, elapsed: float) -> Motion:
    """With the types that never change from frame to frame."""
    return Motion(np.asarray(matrix, np.float32), np.float32(score), size, np.float32(elapsed))


def reduced_size(image: np.ndarray, area_px: int) -> tuple[int, int]:
    """Height and width of an image that has this area at most."""
    height, width = image.shape[:2]
    scale = min(1.0, (area_px / (height * width)) ** 0.5)
    return max(1, round(height * scale)), max(1, round(width * scale))


def _reduce(image: np.ndarray) -> np.ndarray:
    """Gray, at the working size."""
    height, width = reduced_size(image, WORKING_AREA_PX)
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return cv2.resize(gray, (width, height), interpolation=cv2.INTER_AREA)


def _equalize(gray: np.ndarray) -> np.ndarray:
    """The image with local contrast evened out."""
    return cv2.createCLAHE(clipLimit=2.0, tileGridSize=(8, 8)).apply(gray)


def _normalize(gray: np.ndarray) -> np.ndarray:
    """How far each pixel is off the mean around it, in spreads: light changes that little."""
    window = (NORMALIZED_PX, NORMALIZED_PX)
    values = gray.astype(np.float32)
    mean = cv2.blur(values, window)
    spread = np.sqrt(np.maximum(cv2.blur(values**2, window) - mean**2, 0.0))
    off = (values - mean) / (spread + NORMALIZED_SLACK)
    return np.clip(128.0 + NORMALIZED_GAIN * off, 0, 255).astype(np.uint8)


def scale_motion(matrix: np.ndarray, pixel_size: tuple[float, float]) -> np.ndarray:
    """The same similarity between points in pixels of another width and height."""
    size = np.asarray(pixel_size)
    linear = matrix[:, :2] * size[:, None] / size[None, :]
    return np.concatenate([linear, matrix[:, 2:] * size[:, None]], axis=1)


def estimate_motion(
    previous: UInt8[np.ndarray, "h w"], current: UInt8[np.ndarray, "h w"]
) -> tuple[Float[np.ndarray, "2 3"], float]:
    """Fits a similarity to corners that are followed from one gray image to the next.

    Returns:
      The similarity, and the share of the corners that agree with it: 0 if too few do, where the
      similarity is the shift by phase correlation, or none at all.
    """
    matrix, score = _follow(_equalize(previous), _equalize(current))
    if score < GOOD_SCORE:
        again = _follow(_normalize(previous), _normalize(current))
        matrix, score = again if again[1] > score else (matrix, score)
    return matrix, score


def _follow(previous: np.ndarray, current: np.ndarray) -> tuple[np.ndarray, float]:
    """`estimate_motion` by images as they are."""
    shift, response = _correlate(previous, current)
    corners = cv2.goodFeaturesToTrack(previous, MAX_CORNERS, CORNER_QUALITY, CORNER_DISTANCE_PX)
    matrix, score = None, 0.0
    if corners is not None and len(corners) >= MIN_CORNERS:
        matrix, score = _fit(previous, current, corners, shift)
        if score < GOOD_SCORE:
            again, score_again = _fit(previous, current, corners, np.zeros(2, np.float32))
            if score_again > score:
                matrix, score = again, score_again
    if matrix is not None:
        return matrix, score
    matrix = np.eye(2, 3, dtype=np.float32)
    if response > MIN_PHASE_RESPONSE:
        matrix[:, 2] = shift
    return matrix, 0.0


def _correlate(previous: np.ndarray, current: np.ndarray) -> tuple[np.ndarray, float]:
    """Shift by phase correlation at half the working size, and the height of its peak."""
    small = [
        cv2.resize(gray, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA).astype(np.float32)
        for gray in (previous, current)
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
