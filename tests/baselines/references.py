"""The baselines once more, in NumPy and plain loops; `Sight` is a frame as they see it."""

import dataclasses
from collections.abc import Iterable

import numpy as np
from scipy.optimize import linear_sum_assignment

from remind_jax.observation import FrameFeats, Masks


@dataclasses.dataclass
class Sight:
    vectors: np.ndarray  # [n, D], unit length
    classes: np.ndarray
    boxes: np.ndarray
    scores: np.ndarray


def see(frame: tuple[FrameFeats, Masks]) -> Sight:
    feats, masks = frame
    rows = np.flatnonzero(masks.valid)
    weights = masks.coverage[rows].reshape(len(rows), -1).astype(np.float64) ** 2
    patches = np.asarray(feats.patches, np.float64).reshape(weights.shape[1], -1)
    vectors = weights @ patches / weights.sum(axis=1, keepdims=True)
    return Sight(unit(vectors), masks.class_id[rows], masks.box[rows], masks.detector_score[rows])


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def iou(a: np.ndarray, b: np.ndarray) -> float:
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    common = max(width, 0) * max(height, 0)
    area = (a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1])
    return common / (area - common)


def momentum(
    sights: Iterable[Sight], match=0.5, birth=0.1, lowest=0.01, rate=0.3, scale=20.0
) -> list[list[int]]:
    """benchmark.md#momentum-baseline, line by line."""
    memory: list[np.ndarray] = []
    classes: list[int] = []
    answers = []
    for s in sights:
        ids = [-1] * len(s.scores)
        order = sorted(range(len(ids)), key=lambda i: -s.scores[i])
        kept = [
            i
            for rank, i in enumerate(order)
            if s.scores[i] >= 0.5 or all(iou(s.boxes[i], s.boxes[j]) <= 0.3 for j in order[:rank])
        ]
        table = np.zeros((len(kept), len(memory)))
        if table.size:
            known = np.stack(memory)
            likeness = s.vectors[kept] @ known.T
            power = np.exp(scale * likeness)
            both = power / power.sum(1, keepdims=True) + power / power.sum(0, keepdims=True)
            table = (both / 2 + s.vectors[kept] @ unit(known).T) / 2
            table *= s.classes[kept][:, None] == np.array(classes)
        for row, i in enumerate(kept):
            best = int(table[row].argmax()) if memory and table.shape[1] else -1
            if best >= 0 and table[row, best] > match and s.scores[i] > lowest:
                ids[i] = best
                table[row + 1 :, best] = 0
        for i in range(len(ids)):  # new ids by detection, as everywhere here
            if ids[i] == -1 and i in kept and s.scores[i] > birth:
                ids[i] = len(memory)
                memory.append(s.vectors[i])
                classes.append(int(s.classes[i]))
            elif ids[i] >= 0:
                memory[ids[i]] = (1 - rate) * memory[ids[i]] + rate * s.vectors[i]
        answers.append(ids)
    return answers


def running_mean(sights: Iterable[Sight], match=0.75) -> list[list[int]]:
    views: list[list[np.ndarray]] = []
    classes: list[int] = []
    answers = []
    for s in sights:
        ids = [-1] * len(s.classes)
        means = [unit(np.mean(v, axis=0)) for v in views]
        pairs = [
            (-float(s.vectors[i] @ mean), i, o)
            for i in range(len(ids))
            for o, mean in enumerate(means)
            if classes[o] == s.classes[i]
        ]
        for negative, i, o in sorted(pairs):
            if -negative >= match and ids[i] == -1 and o not in ids:
                ids[i] = o
        for i in range(len(ids)):
            if ids[i] == -1:
                ids[i] = len(views)
                views.append([])
                classes.append(int(s.classes[i]))
            views[ids[i]].append(s.vectors[i])
        answers.append(ids)
    return answers


def bank(sights: Iterable[Sight], match=0.75, num_views=12) -> list[list[int]]:
    views: list[list[tuple[np.ndarray, int]]] = []
    classes: list[int] = []
    answers = []
    for s in sights:
        ids = [-1] * len(s.classes)
        score = np.full((len(ids), len(views)), -1.0)
        for i in range(len(ids)):
            for o, known in enumerate(views):
                if classes[o] == s.classes[i]:
                    score[i, o] = max(float(s.vectors[i] @ v) for v, _ in known)
        worth = np.where(score >= match, score - match, 0.0)
        for i, o in zip(*linear_sum_assignment(-worth), strict=True):
            if worth[i, o] > 0:
                ids[i] = int(o)
        for i in range(len(ids)):
            if ids[i] == -1:
                ids[i] = len(views)
                views.append([])
                classes.append(int(s.classes[i]))
            known = views[ids[i]]
            known.append((s.vectors[i], 1))
            if len(known) > num_views:
                vectors = np.stack([v for v, _ in known])
                likeness = np.where(np.triu(np.ones((len(known),) * 2), 1), vectors @ vectors.T, -2)
                a, b = np.unravel_index(likeness.argmax(), likeness.shape)
                (va, wa), (vb, wb) = known[a], known[b]
                known[a] = (unit(wa * va + wb * vb), wa + wb)
                newest = known.pop()
                if b < len(known):
                    known[b] = newest
        answers.append(ids)
    return answers


def boxes(sights: Iterable[Sight], min_iou=0.3, patience=1) -> list[list[int]]:
    known: dict[int, tuple[np.ndarray, int, int]] = {}  # id -> box, class, frame
    num, answers = 0, []
    for frame, s in enumerate(sights):
        known = {o: k for o, k in known.items() if frame - k[2] <= patience}
        names = list(known)
        score = np.zeros((len(s.classes), len(names)))
        for i in range(len(s.classes)):
            for column, o in enumerate(names):
                overlap = iou(s.boxes[i], known[o][0])
                if known[o][1] == s.classes[i] and overlap >= min_iou:
                    score[i, column] = overlap
        ids = [-1] * len(s.classes)
        for i, column in zip(*linear_sum_assignment(-score), strict=True):
            if score[i, column] > 0:
                ids[i] = names[column]
        for i in range(len(ids)):
            if ids[i] == -1:
                ids[i], num = num, num + 1
            known[ids[i]] = (s.boxes[i], int(s.classes[i]), frame)
        answers.append(ids)
    return answers
