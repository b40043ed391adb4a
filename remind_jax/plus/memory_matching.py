"""Which objects of two memories are one, by their looks and by whom they were seen with (host).

Rule: method_plus.md#joining.

Letters: `M` objects there, `C` candidates here of each, `R` objects of either, `S` statements of
partners about candidates, `L` looks, `D` feature dimension, `E` directions that looks are compared
in. Evidence is in log odds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy import sparse
from scipy.sparse.csgraph import min_weight_full_bipartite_matching

from remind_jax.plus import thresholds as th
from remind_jax.plus.archive import NO_PARTNERS, Resting
from remind_jax.plus.class_names import confusion_odds, least_seen, name_odds
from remind_jax.plus.decision import LEAST_NEWNESS
from remind_jax.plus.evidence import (
    FREE_RIVALS,
    RING_BEST,
    RING_MIDDLE,
    RING_SLOPE,
    look_odds_of,
    mix,
    relation_error,
)
from remind_jax.plus.layout import PAIR_BEST, PARTNERS, RELATION_DOUBT, RELATION_LOST
from remind_jax.plus.look_index import Whitener
from remind_jax.plus.state import NO_RELATION, Scene
from remind_jax.plus.whitening import adjust_cosine

NUM_CANDIDATES = 8  # objects here that each object there may be
# Log odds by which a match must lead over any other one, and over "new"; else it stays apart.
LEAD, LEAD_OVER_NEW = 1.5, 0.8
TYPICAL_SHARE = 0.2  # of what an object was seen with stands beside another one by chance
COMPANY_BEST = 2.5  # limit of that evidence to both sides, log odds
LEAST_NEW = 1 / 3  # share of the objects there that is assumed to be new at least
_AT_ONCE = 256  # objects there, or pairs of them, that are compared at once
NOBODY = -1  # no row
_ROUNDS = 5  # in which the share of new things settles


class Side(NamedTuple):
    """All objects of a memory, row by row."""

    objects: Sequence[Resting]
    first: Int[np.ndarray, "R"]  # row of an object, and ...
    second: Int[np.ndarray, "R"]  # ... of one that was seen with it
    partner: np.ndarray  # what is known of the two: fields as in `Archive.partners`
    group: Int[np.ndarray, "R"]  # row that stands for all that were declared to be one object

    @classmethod
    def of(
        cls,
        objects: Mapping[int, Resting],
        partners: Mapping[int, np.ndarray],
        merged_into: Mapping[int, int] = MappingProxyType({}),
    ) -> Side:
        """Those that have looks, sorted by the rows of pairs; some were declared to be others."""
        kept = [one for one in objects.values() if len(one.bank)]
        row_of = {one.id: row for row, one in enumerate(kept)}
        of_each = [partners.get(one.id, NO_PARTNERS) for one in kept]
        lengths = [len(of_one) for of_one in of_each]
        partner = np.concatenate([*of_each, NO_PARTNERS])
        first = np.repeat(np.arange(len(kept)), lengths)
        second = np.array([row_of.get(one, NOBODY) for one in partner["id"].tolist()], int)
        # What is known of two may be kept with one of them only.
        back = partner.copy()
        back["relation"], back["log_ratio"] = -partner["relation"], -partner["log_ratio"]
        first, second = np.concatenate([first, second]), np.concatenate([second, first])
        partner = np.concatenate([partner, back])
        present = np.flatnonzero((first != NOBODY) & (second != NOBODY))
        keys = first[present] * len(kept) + second[present]
        order = present[np.unique(keys, return_index=True)[1]]  # sorted, each once
        shown = [merged_into.get(one.id, one.id) for one in kept]
        first_row = {one: row for row, one in reversed([*enumerate(shown)])}
        group = np.array([row_of.get(one, first_row[one]) for one in shown], int)
        return cls(kept, first[order], second[order], partner[order], group)

    def values(self, name: str) -> np.ndarray:
        """A field of all objects."""
        return np.stack([one.values[name] for one in self.objects])


class _Candidates(NamedTuple):
    """What each object there may be."""

    row: Int[np.ndarray, "M C"]  # of objects here, NOBODY where there are fewer
    cosine: Float[np.ndarray, "M C"]  # of the looks that are most alike
    name: Float[np.ndarray, "M C"]  # log odds that one thing has both names, 0 at most
    rivals: Float[np.ndarray, "M"]  # objects here, by how likely they are called so


class _Statements(NamedTuple):
    """What pairs of objects here, and the same pairs there, say for each other."""

    about: Int[np.ndarray, "S"]  # place of the candidate in `M C`
    by: Int[np.ndarray, "S"]  # place of the candidate of the partner
    lies: Float[np.ndarray, "S"]  # log odds of how they lie, 0 where that is not known
    related: Bool[np.ndarray, "S"]  # it is known
    beside: Float[np.ndarray, "S"]  # share of its frames in which the partner was in view, ...
    company: Float[np.ndarray, "M"]  # ... and the sum of these of all partners of an object


def match(
    here: Side, there: Side, scene: Scene, t: th.PlusThresholds
) -> tuple[Int[np.ndarray, "M"], dict[int, Int[np.ndarray, "rivals"]]]:
    """Rows here of the objects there, NOBODY for new ones; rows that the doubtful ones may be."""
    candidates = _find_candidates(here, there, scene, t.names)
    base = _own_evidence(here, there, candidates, scene, t)
    odds = _weigh_company(base, _ask_company(here, there, candidates, t), t)
    asking, row, odds = _by_group(odds, candidates.row, here.group, there.group)
    found, doubted = _decide(odds, row, len(here.objects), _expect_new(odds, t.decision))
    of_all, standing = np.full(len(there.objects), NOBODY), there.group[asking]
    of_all[standing] = found
    return of_all, {int(standing[m]): rows for m, rows in doubted.items()}


def _find_candidates(here: Side, there: Side, scene: Scene, t: th.Names) -> _Candidates:
    """The objects here that look most alike, of the classes that each there may be called."""
    num, whitener = len(there.objects), Whitener.of(scene)
    found = _Candidates(
        np.full((num, NUM_CANDIDATES), NOBODY),
        np.full((num, NUM_CANDIDATES), -1.0, np.float32),
        np.zeros((num, NUM_CANDIDATES), np.float32),
        np.zeros(num, np.float32),
    )
    classes, class_of = np.unique(here.values("class_id"), return_inverse=True)
    classes_there = there.values("class_id")
    asked_classes = np.unique(classes_there)
    names = np.asarray(_name_odds(asked_classes, classes, scene, t))
    least = np.asarray(least_seen(t))
    for one_class, name in zip(asked_classes, names, strict=True):
        # Others are asked only where the detector was seen to change between both names.
        rows = np.flatnonzero((name > least)[class_of])
        if not len(rows):
            continue
        name_of_row = name[class_of[rows]]
        looks, starts = _looks(here, rows, whitener)
        asking = np.flatnonzero(classes_there == one_class)
        found.rivals[asking] = np.sum(np.exp(name_of_row))
        for start in range(0, len(asking), _AT_ONCE):
            asked = asking[start : start + _AT_ONCE]
            own, own_starts = _looks(there, asked, whitener)
            of_looks = np.maximum.reduceat(own @ looks.T, starts, axis=1)
            cosine = np.maximum.reduceat(of_looks, own_starts, axis=0)
            best = np.argsort(-cosine, axis=1, kind="stable")[:, :NUM_CANDIDATES]
            width = best.shape[1]
            found.row[asked, :width] = rows[best]
            found.cosine[asked, :width] = np.take_along_axis(cosine, best, axis=1)
            found.name[asked, :width] = name_of_row[best]
    return found


def _looks(
    side: Side, rows: Int[np.ndarray, "rows"], whitener: Whitener
) -> tuple[Float[np.ndarray, "L E"], Int[np.ndarray, "rows"]]:
    """Whitened looks of some objects, and where those of each start."""
    banks = [side.objects[row].bank for row in rows.tolist()]
    starts = np.cumsum([0, *(len(bank) for bank in banks[:-1])])
    class_id = np.repeat(side.values("class_id")[rows], [len(bank) for bank in banks])
    return whitener.whiten(np.concatenate(banks), class_id), starts


def _own_evidence(
    here: Side, there: Side, candidates: _Candidates, scene: Scene, t: th.PlusThresholds
) -> Float[np.ndarray, "M C"]:
    """Log odds of looks, background and name of each candidate, less its rivals; else -inf."""
    looks = np.asarray(_look_odds(candidates.cosine, there.values("class_id"), scene, t))
    looks = np.clip(looks, t.looks.worst, t.looks.best)
    rings = [_rings(side, np.asarray(scene.ring_mean)) for side in (here, there)]
    cosine = np.einsum("mcd,md->mc", rings[0][candidates.row], rings[1])
    known = [side.values("ring_count") > 0 for side in (here, there)]
    ring = RING_SLOPE * (cosine - RING_MIDDLE)
    ring = t.looks.ring_weight * np.clip(ring, -RING_BEST, RING_BEST)
    ring = np.where(known[0][candidates.row] & known[1][:, None], ring, 0.0)
    rivals = np.maximum(candidates.rivals, FREE_RIVALS) / FREE_RIVALS
    odds = looks + ring + candidates.name - t.decision.crowd * np.log(rivals)[:, None]
    return np.where(candidates.row == NOBODY, -np.inf, odds)


def _rings(side: Side, mean: Float[np.ndarray, "D"]) -> Float[np.ndarray, "R D"]:
    rings = side.values("ring") - mean
    return rings / np.maximum(np.linalg.norm(rings, axis=1, keepdims=True), 1e-12)


def _ask_company(
    here: Side, there: Side, candidates: _Candidates, t: th.PlusThresholds
) -> _Statements:
    """All pairs of candidates of two objects there that were seen together here as well."""
    num, width = len(here.objects), candidates.row.shape[1]
    keys = here.first * num + here.second  # rising
    about, by, pair_there, pair_here = [], [], [], []
    for start in range(0, len(there.first), _AT_ONCE):
        pairs = np.arange(start, min(start + _AT_ONCE, len(there.first)))
        first, second = (candidates.row[side[pairs]] for side in (there.first, there.second))
        asked = first[:, :, None] * num + second[:, None]
        place = np.minimum(np.searchsorted(keys, asked), max(len(keys) - 1, 0))
        both = (first[:, :, None] != NOBODY) & (second[:, None] != NOBODY)
        known = both & (keys[place] == asked) if len(keys) else np.zeros_like(both)
        pair, c, d = np.nonzero(known)
        about.append(there.first[pairs[pair]] * width + c)
        by.append(there.second[pairs[pair]] * width + d)
        pair_there.append(pairs[pair])
        pair_here.append(place[known])
    none = [np.zeros(0, int)]
    at_there, at_here = np.concatenate(pair_there + none), np.concatenate(pair_here + none)
    known_there, known_here = there.partner[at_there], here.partner[at_here]
    size = there.values("size")
    scale = np.sqrt(size[there.first[at_there]] * size[there.second[at_there]])
    share = there.partner["covisible"] / np.maximum(there.values("seen"), 1)[there.first]
    company = np.bincount(there.first, share, len(there.objects))
    lies, related = _compare_layout(known_here, known_there, scale, t)
    return _Statements(
        np.concatenate(about + none),
        np.concatenate(by + none),
        lies,
        related,
        share[at_there],
        company,
    )


def _compare_layout(
    here: np.ndarray, there: np.ndarray, scale: Float[np.ndarray, "S"], t: th.PlusThresholds
) -> tuple[Float[np.ndarray, "S"], Bool[np.ndarray, "S"]]:
    """Does one lie from the other here as there? As `layout` asks it of two detections."""
    related = (here["spread"] < NO_RELATION) & (there["spread"] < NO_RELATION)
    off = here["relation"] - there["relation"]
    spread = np.hypot(here["spread"], there["spread"])
    squared = np.sum(off**2, axis=1) * scale**2
    odds = np.asarray(_layout_odds(squared, there["relation"], spread, scale, t))
    odds = np.clip(odds, -PAIR_BEST, PAIR_BEST)
    return np.where(related, odds, 0.0), related


@jax.jit
def _name_odds(
    there: Int[Array, "K"], here: Int[Array, "L"], scene: Scene, t: th.Names
) -> Float[Array, "K L"]:
    """That one thing has the names of both classes."""
    return name_odds(there, here, confusion_odds(scene, t))


@jax.jit
def _look_odds(
    cosine: Float[Array, "M C"], class_id: Int[Array, "M"], scene: Scene, t: th.PlusThresholds
) -> Float[Array, "M C"]:
    """What cosines of whitened looks tell of objects of these classes."""
    return look_odds_of(adjust_cosine(scene, cosine), class_id, scene, t)


@jax.jit
def _layout_odds(
    squared: Float[Array, "S"],
    relation: Float[Array, "S 2"],
    spread: Float[Array, "S"],
    scale: Float[Array, "S"],
    t: th.PlusThresholds,
) -> Float[Array, "S"]:
    """That two lie from each other as before, by the squared distance in which they do not."""
    error = relation_error(relation, spread, jnp.zeros(len(spread), bool), t.layout)
    variance = (error * scale) ** 2
    return mix(squared, variance, RELATION_LOST, RELATION_DOUBT, 0.0)


def _weigh_company(
    base: Float[np.ndarray, "M C"], said: _Statements, t: th.PlusThresholds
) -> Float[np.ndarray, "M C"]:
    """Log odds with what the partners say, each by how far it is believed to be its own one."""
    layout, odds = t.layout, base
    for _ in range(int(layout.rounds) + 1):
        weight = _believe(odds, float(t.decision.new)).reshape(-1)[said.by]

        def add_up(values: np.ndarray, weight: np.ndarray = weight) -> np.ndarray:
            return np.bincount(said.about, values * weight, base.size).reshape(base.shape)

        num = np.maximum(add_up(said.related), 1e-6)
        lies = add_up(said.lies) * np.minimum(1.0, PARTNERS / num)
        lies = layout.weight * np.clip(lies, -layout.best, layout.best)
        together = np.log((add_up(said.beside) + TYPICAL_SHARE) / (1.0 + said.company[:, None]))
        together -= np.log(TYPICAL_SHARE)
        together = np.clip(together, -COMPANY_BEST, COMPANY_BEST)
        # From elsewhere even what stands still lies otherwise.
        odds = base + np.maximum(lies, 0.0) + together
    return odds


def _believe(odds: Float[np.ndarray, "M C"], new: float) -> Float[np.ndarray, "M C"]:
    """Probability of each candidate beside all others and a new object."""
    most = np.maximum(np.max(odds, axis=1, keepdims=True), new)
    likely = np.exp(odds - most)
    return likely / (np.sum(likely, axis=1, keepdims=True) + np.exp(new - most))


def _expect_new(odds: Float[np.ndarray, "M C"], t: th.Decision) -> float:
    """Log odds of a new object: the fewer seem to be known, the more a known one has to show."""
    new = float(t.new)
    for _ in range(_ROUNDS):
        seem_new = 1.0 - np.sum(_believe(odds, new), axis=1)
        share = np.clip(np.mean(seem_new), LEAST_NEW, 1.0 - LEAST_NEWNESS)
        new = float(t.new + t.familiarity * np.log(share / (1.0 - share)))
    return new


def _by_group(
    odds: Float[np.ndarray, "M C"],
    row: Int[np.ndarray, "M C"],
    here: Int[np.ndarray, "R"],
    there: Int[np.ndarray, "M"],
) -> tuple[Int[np.ndarray, "G"], Int[np.ndarray, "G C"], Float[np.ndarray, "G C"]]:
    """What was declared one, by its likeliest member there and the likeliest member of each here.

    Returns:
      Rows there, and of each the rows that stand for its candidates here and their log odds.
    """
    best_first = np.argsort(-odds, axis=1, kind="stable")
    odds, row = (np.take_along_axis(values, best_first, axis=1) for values in (odds, row))
    group = np.where(row == NOBODY, NOBODY, here[row])
    is_before = np.tri(row.shape[1], k=-1, dtype=bool)
    is_again = np.any((group[:, :, None] == group[:, None]) & is_before, axis=2)
    odds = np.where(is_again, -np.inf, odds)
    likeliest_first = np.lexsort([-odds[:, 0], there])
    asking = likeliest_first[np.unique(there[likeliest_first], return_index=True)[1]]
    return asking, group[asking], odds[asking]


def _decide(
    odds: Float[np.ndarray, "M C"], row: Int[np.ndarray, "M C"], num_here: int, new: float
) -> tuple[Int[np.ndarray, "M"], dict[int, Int[np.ndarray, "rivals"]]]:
    """One assignment with a private column for "new"; what does not lead clearly stays apart."""
    place = _assign(odds, row, num_here, new)
    is_held = np.arange(odds.shape[1]) == place[:, None]
    own = np.where(place == NOBODY, new, np.max(np.where(is_held, odds, -np.inf), axis=1))
    others = np.where(is_held, -np.inf, odds)
    held = np.flatnonzero(place != NOBODY)
    objects = row[held, place[held]]
    # What an object would lose without its own one; another that wants that has to pay for it.
    price = np.zeros(num_here)
    price[objects] = np.maximum(own - np.maximum(np.max(others, axis=1), new), 0.0)[held]
    instead = np.max(others - price[row], axis=1)
    lead = own - instead
    # Or another one that wants it gives up what it has.
    holder = np.full(num_here, NOBODY)
    holder[objects] = held
    wants, c = np.nonzero((others > -np.inf) & (holder[row] != NOBODY))
    owner = holder[row[wants, c]]
    loss = (own - np.maximum(instead, new))[owner] - (others[wants, c] - own[wants])
    np.minimum.at(lead, owner, loss)
    sure = held[(lead[held] >= LEAD) & (own[held] >= new + LEAD_OVER_NEW)]
    found = np.full(len(odds), NOBODY)
    found[sure] = row[sure, place[sure]]
    possible = (odds > new - LEAD) & ~np.isin(row, found[sure])
    possible[sure] = False
    doubted = {}
    for m in np.flatnonzero(possible.any(axis=1)).tolist():
        best_first = np.argsort(-odds[m], kind="stable")
        doubted[m] = row[m, best_first[possible[m, best_first]]]
    return found, doubted


def _assign(
    odds: Float[np.ndarray, "M C"], row: Int[np.ndarray, "M C"], num_here: int, new: float
) -> Int[np.ndarray, "M"]:
    """Places of the chosen candidates, NOBODY for new ones."""
    num = len(odds)
    wins, c = np.nonzero(odds > new)
    at = np.concatenate([wins, np.arange(num)])
    column = np.concatenate([row[wins, c], num_here + np.arange(num)])
    # A constant added to all changes nothing; zeros would be left out of the graph.
    gain = np.concatenate([odds[wins, c] - new, np.zeros(num)]) + 1.0
    graph = sparse.csr_array((gain, (at, column)), shape=(num, num_here + num))
    chosen = min_weight_full_bipartite_matching(graph, maximize=True)[1]
    is_chosen = row == chosen[:, None]
    return np.where(is_chosen.any(axis=1), np.argmax(is_chosen, axis=1), NOBODY)
