"""Channel weights by gradients, through a soft assignment in place of the real one.

Identities are chosen by rules and an optimal assignment, which have no useful derivative. The
surrogate keeps what weights act on, the visual score of each candidate, and lets candidates and
"none of them" share a detection by a softmax. It looks at memories as one run built them and at
each detection alone, so what it proposes has to be scored by a sweep, beside what a search finds.

Letters: `N` detections, `C` candidates, `T` terms (object, background, parts, ring prototypes).
"""

from __future__ import annotations

import collections
import dataclasses
from collections.abc import Iterable

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, Float

from remind_jax.errors import SweepError
from remind_jax.explanation.remind.explainer import FrameRecord
from remind_jax.frame import NO_INSTANCE
from remind_jax.method import PAPER_METHOD
from remind_jax.outputs.result import Result
from remind_jax.remind.thresholds import Thresholds
from remind_jax.sweeps.settings import Setting

WEIGHTS = ("object_weight", "background_weight", "parts_weight", "ring_prototypes_weight")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Candidates:
    """What detections with known truth were compared with."""

    value: Float[Array, "N C T"]  # score of each term
    factor: Float[Array, "N C T"]  # its weight without the nominal one; 0 where it is absent
    shown: Bool[Array, "N C"]  # not padding
    right: Bool[Array, "N C"]  # shows the same object; in no row: the object is new

    def __len__(self) -> int:
        return len(self.shown)


@dataclasses.dataclass(frozen=True)
class Fit:
    """What the gradients found."""

    setting: Setting
    loss: Float[np.ndarray, "K"]  # mean negative log-likelihood of the truth, step by step


def collect_candidates(result: Result, thresholds: Thresholds) -> Candidates:
    """Candidates of the detections of a traced run, with the truth of its masks.

    An identity stands for the object that it was given to most often before. Detections whose
    object has an identity that is not among the candidates shown are left out.

    Args:
      result: Of a run with `trace=True` on annotated masks.
      thresholds: That it was made with.

    Raises:
      SweepError: If the run was not traced, is of a tracker without these weights, or nothing in it
        can be learned from.
    """
    if result.trace is None:
        raise SweepError(f"the run '{result.info.name}' was not traced; run it with trace=True")
    tracker = result.info.config.get("tracker", PAPER_METHOD)
    if tracker != PAPER_METHOD:
        raise SweepError(
            f"the run '{result.info.name}' is of tracker '{tracker}', which has no weights of "
            f"channels; run '{PAPER_METHOD}' or search instead"
        )
    t = thresholds.similarity
    nominal = np.array([getattr(t, name) for name in WEIGHTS], float)
    given: dict[int, collections.Counter[int]] = collections.defaultdict(collections.Counter)
    rows: list[tuple[np.ndarray, ...]] = []
    for tracks in result.tracks:
        record = result.trace.frame(tracks.frame_index)
        shows = {i: counts.most_common(1)[0][0] for i, counts in given.items()}
        for row, instance in enumerate(tracks.instance_ids.tolist()):
            if not isinstance(record, FrameRecord) or instance == NO_INSTANCE:
                continue
            c = record.detections.candidates
            ids = np.asarray(c.id[row])
            right = np.array([shows.get(i) == instance for i in ids.tolist()], bool)
            if (ids >= 0).any() and (right.any() or instance not in shows.values()):
                terms = np.asarray(c.value[row]).shape[-1]
                known = np.asarray(c.present[row]) & (nominal[:terms] > 0)
                factor = np.asarray(c.weight[row]) / np.where(nominal > 0, nominal, 1)[:terms]
                value = np.where(known, c.value[row], 0.0)
                rows.append((value, np.where(known, factor, 0.0), ids >= 0, right))
        for instance, object_id in zip(tracks.instance_ids, tracks.object_id, strict=True):
            if object_id >= 0 and instance != NO_INSTANCE:
                given[int(object_id)][int(instance)] += 1
    if not rows:
        raise SweepError(f"the run '{result.info.name}' has no detection with truth and candidates")
    return _stack(rows)


def join_candidates(several: Iterable[Candidates]) -> Candidates:
    """The detections of several runs, in one."""
    rows = [
        tuple(np.asarray(getattr(c, field.name)[i]) for field in dataclasses.fields(c))
        for c in several
        for i in range(len(c))
    ]
    return _stack(rows)


def fit_weights(
    candidates: Candidates,
    thresholds: Thresholds,
    *,
    temperature: float = 0.05,
    num_steps: int = 400,
    learning_rate: float = 0.03,
) -> Fit:
    """Moves channel weights and the match threshold to where the truth is most likely.

    Args:
      candidates: From `collect_candidates`.
      thresholds: Where to start; weights keep their sum, and those at 0 stay there.
      temperature: Of the soft assignment, in units of the score.
      num_steps: Steps of Adam.
      learning_rate: Of Adam.

    Returns:
      Values of the thresholds, ready for a sweep.
    """
    t = thresholds.similarity
    terms = candidates.value.shape[-1]
    start = jnp.array([getattr(t, name) for name in WEIGHTS[:terms]], jnp.float32)
    total = jnp.sum(start)
    used = start > 0

    def weights_of(logits: Array) -> Array:
        return total * jax.nn.softmax(jnp.where(used, logits, -jnp.inf))

    def loss(params: tuple[Array, Array]) -> Array:
        logits, match = params
        return surrogate_loss(candidates, weights_of(logits), match, temperature)

    optimizer = optax.adam(learning_rate)
    params = jnp.log(jnp.where(used, start, 1.0)), jnp.float32(thresholds.matching.match)

    def move(carry: tuple, _: None) -> tuple[tuple, Array]:
        params, state = carry
        value, slope = jax.value_and_grad(loss)(params)
        updates, state = optimizer.update(slope, state)
        return (optax.apply_updates(params, updates), state), value

    run = jax.jit(lambda p: jax.lax.scan(move, (p, optimizer.init(p)), None, num_steps))
    ((logits, match), _), history = run(params)
    weights = np.asarray(weights_of(logits), float)
    setting: Setting = {
        f"similarity.{name}": float(f"{weight:.6g}")
        for name, weight, is_used in zip(WEIGHTS, weights, used.tolist(), strict=False)
        if is_used
    }
    setting["matching.match"] = float(f"{float(np.clip(match, 0.0, 1.0)):.6g}")
    return Fit(setting, np.asarray(history))


def surrogate_loss(
    candidates: Candidates, weights: Float[Array, "T"], match: Float[Array, ""], temperature: float
) -> Float[Array, ""]:
    """Mean negative log-likelihood of the truth under a soft assignment of each detection.

    A candidate weighs by how far its visual score is above `match`, "none of them" by 0.
    """
    weight = weights * candidates.factor
    total = jnp.sum(weight, axis=-1)
    score = jnp.sum(weight * candidates.value, axis=-1) / jnp.where(total > 0, total, 1.0)
    logits = jnp.where(candidates.shown, (score - match) / temperature, -jnp.inf)
    logits = jnp.concatenate([logits, jnp.zeros((len(logits), 1))], axis=1)
    is_new = ~jnp.any(candidates.right, axis=1, keepdims=True)
    right = jnp.concatenate([candidates.right & candidates.shown, is_new], axis=1)
    everything = jax.nn.logsumexp(logits, axis=1)
    truth = jax.nn.logsumexp(jnp.where(right, logits, -jnp.inf), axis=1)
    return jnp.mean(everything - truth)


def _stack(rows: list[tuple[np.ndarray, ...]]) -> Candidates:
    """Rows of different numbers of candidates, padded."""
    most = max(len(row[2]) for row in rows)

    def stack(place: int) -> Array:
        several = [row[place] for row in rows]
        widths = [[(0, most - len(a)), *((0, 0),) * (a.ndim - 1)] for a in several]
        return jnp.asarray(np.stack([np.pad(a, w) for a, w in zip(several, widths, strict=True)]))

    return Candidates(stack(0), stack(1), stack(2), stack(3))
