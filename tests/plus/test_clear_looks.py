"""Where looks are clear they decide, whatever stands where: no one is taken for another."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.numerics.absent import NO_ID
from remind_jax.plus.state import PlusState
from remind_jax.static import Static
from tests.plus.frames import detections, motion
from tests.plus.walls import NO_TRUTH, Walk, follow

PER_PLACE, NUM_PLACES, NUM_FRAMES, DIM = 12, 5, 10, 64
STATIC = Static(num_detections=PER_PLACE, num_objects=128, feature_dim=DIM)
GRID = np.array([[0.8 + 1.5 * (k % 4), 0.8 + 1.4 * (k // 4)] for k in range(PER_PLACE)])


@pytest.mark.parametrize("num_classes", [40, 8, 1])
@pytest.mark.parametrize("seed", [0, 1])
def test_places_that_lie_alike_are_told_apart_over_cuts(num_classes, seed):
    rng = np.random.default_rng(seed)
    num = PER_PLACE * NUM_PLACES
    looks = rng.normal(size=(num, DIM))  # nearly orthogonal
    classes = rng.integers(0, num_classes, num)
    order = [*range(NUM_PLACES), *rng.permutation(NUM_PLACES)]
    things = np.repeat(np.array(order), NUM_FRAMES)[:, None] * PER_PLACE + np.arange(PER_PLACE)
    seen = [
        detections(
            GRID + rng.normal(scale=0.01, size=GRID.shape),
            looks[row] + rng.normal(scale=0.1, size=(PER_PLACE, DIM)),
            class_id=classes[row],
        )
        for row in things
    ]
    sightings = jax.tree.map(lambda *leaves: np.stack(leaves), *seen)
    unknown = jax.tree.map(lambda leaf: np.stack([leaf] * len(things)), motion(score=0.0))
    _, verdicts, _, _ = follow(Walk(sightings, unknown, things), static=STATIC)
    answers = verdicts.answer_id
    last = answers[NUM_FRAMES - 1 :: NUM_FRAMES]
    first, again = (
        dict(zip(things[rows].ravel().tolist(), last[half].ravel().tolist(), strict=True))
        for rows, half in (
            (slice(0, NUM_PLACES * NUM_FRAMES, NUM_FRAMES), slice(0, NUM_PLACES)),
            (slice(NUM_PLACES * NUM_FRAMES, None, NUM_FRAMES), slice(NUM_PLACES, None)),
        )
    )
    assert NO_ID not in first.values()
    assert len(set(first.values())) == num, "each has an identity of its own"
    assert again == first


@dataclasses.dataclass
class World:
    """What is seen frame by frame: things with looks of their own at places of a grid."""

    rng: np.random.Generator
    num_things: int
    noise: float = 0.1  # of looks, whose components have a standard deviation of 1
    size: float = 1.0
    elapsed: float = 1.0  # ticks from frame to frame

    def __post_init__(self):
        self.looks = self.rng.normal(size=(self.num_things, DIM))
        self.seen, self.motions, self.things = [], [], []

    def show(self, placed: dict[int, int], frames: int = 1, still: bool = True) -> None:
        """Things at places; `still`: whether the image is known to go on."""
        row = np.array([*placed, *[NO_TRUTH] * (PER_PLACE - len(placed))])
        center = np.array([GRID[placed.get(thing, 0)] for thing in row.tolist()])
        for _ in range(frames):
            middle = center + self.rng.normal(scale=0.01, size=center.shape)
            half = self.size / 2
            self.seen.append(
                detections(
                    middle,
                    self.looks[row] + self.rng.normal(scale=self.noise, size=(PER_PLACE, DIM)),
                    box=np.concatenate([middle - half, middle + half], axis=1, dtype=np.float32),
                    size=np.full(PER_PLACE, self.size, np.float32),
                    valid=row != NO_TRUTH,
                )
            )
            elapsed = jnp.float32(self.elapsed)
            self.motions.append(dataclasses.replace(motion(score=float(still)), elapsed=elapsed))
            self.things.append(row)

    def identities(self) -> tuple[np.ndarray, np.ndarray, PlusState]:
        """The thing of every detection, and its answer, NO_ID while undecided; and the memory."""
        while len(self.things) % 10:  # walks of these lengths share a program
            self.show({}, still=False)
        seen, moves = (
            jax.tree.map(lambda *leaves: np.stack(leaves), *frames)
            for frames in (self.seen, self.motions)
        )
        things = np.array(self.things)
        state, _, decisions, _ = follow(Walk(seen, moves, things), static=STATIC)
        return things, decisions.object_id, state

    def wrong(self) -> list[tuple[int, int, int]]:
        """Frame, thing and identity wherever a thing is firmly answered as another one."""
        things, ids, _ = self.identities()
        owner: dict[int, int] = {}
        return [
            (int(frame), int(things[frame, k]), int(ids[frame, k]))
            for frame, k in np.argwhere((things != NO_TRUTH) & (ids != NO_ID))
            if owner.setdefault(int(ids[frame, k]), int(things[frame, k])) != things[frame, k]
        ]


@pytest.mark.parametrize("still", [True, False])
@pytest.mark.parametrize("num", [1, 2, 4, 8])
@pytest.mark.parametrize("frames", [1, 3, 8, 30])
def test_what_takes_the_place_of_another_between_two_frames_is_another(num, frames, still):
    """As it does over a cut, and before a camera that does not notice."""
    world = World(np.random.default_rng(10 * frames + num), num + 1)
    before = {k: k for k in range(num)}
    world.show(before, frames, still)
    world.show({k: k for k in range(1, num)} | {num: 0}, 12, still)
    if num > 1:
        world.show({num: 1, 1: 0} | {k: k for k in range(2, num)}, 12, still)
    assert not world.wrong()


@pytest.mark.parametrize("elapsed", [0.5, 1.0, 3.0, 5.0, 20.0])
@pytest.mark.parametrize("first", [2, 3, 5, 12])
def test_what_is_elsewhere_soon_after_it_came_keeps_its_identity(first, elapsed):
    """Whether it was decided by then or not, and however fast the camera is."""
    world = World(np.random.default_rng(first), 5, elapsed=elapsed)
    frames = int(first / min(elapsed, 1.0))
    world.show({k: k for k in range(5)}, frames)
    world.show({k: 11 - k for k in range(5)}, 57 - frames, still=False)
    things, ids, _ = world.identities()
    last = dict(zip(things[56].tolist(), ids[56].tolist(), strict=True))
    assert [last[thing] for thing in things[0, :5].tolist()] == ids[0, :5].tolist()


def test_what_begins_tells_nothing_of_how_alike_others_look():
    """It was compared with nothing, and not found to be unlike everything."""
    world = World(np.random.default_rng(0), 6)
    world.show({0: 0, 1: 1}, 1)
    world.show({k: k for k in range(6)}, 9)
    _, _, state = world.identities()
    mean = state.scene.cosine_sum[0] / state.scene.cosine_weight[0]
    variance = state.scene.cosine_squares[0] / state.scene.cosine_weight[0] - mean**2
    assert variance < 0.05


def test_of_two_that_may_go_on_the_one_that_it_looks_like_does():
    """Not the one that it covers more, although that one looks like it as well."""
    look = np.linalg.qr(np.random.default_rng(0).normal(size=(DIM, PER_PLACE)))[0].T
    look[1] = 0.93 * look[0] + np.sqrt(1 - 0.93**2) * look[1]
    middle = GRID.copy()
    middle[1] = middle[0] + [1.2, 0.0]
    moved, gone = middle.copy(), np.arange(PER_PLACE) == 0
    moved[1] = middle[0] + [0.3, 0.0]
    seen = [detections(middle, look), *[detections(moved, look, valid=~gone)] * 2]
    things = np.array([[*range(PER_PLACE)], *[[NO_TRUTH, *range(1, PER_PLACE)]] * 2])
    sightings = jax.tree.map(lambda *leaves: np.stack(leaves), *seen)
    still = jax.tree.map(lambda leaf: np.stack([leaf] * len(seen)), motion())
    tracklet = follow(Walk(sightings, still, things), static=STATIC)[1].tracklet_id
    assert (tracklet[1:, 1:] == tracklet[0, 1:]).all()


def test_who_comes_to_one_spot_in_turn_is_not_one():
    for stay in (0, 2):
        world = World(np.random.default_rng(stay), 8)
        for visitor in [*range(6), *range(6)]:
            world.show({visitor: 0} | {6 + k: 4 + k for k in range(stay)}, frames=10)
        assert not world.wrong(), stay


def test_who_is_known_among_many_is_known_alone_and_elsewhere():
    rng = np.random.default_rng(3)
    world = World(rng, 5 * PER_PLACE)
    for first in range(0, 5 * PER_PLACE, PER_PLACE):
        world.show({first + k: k for k in range(PER_PLACE)}, 10, still=False)
    known = len(world.things)
    for thing in rng.permutation(5 * PER_PLACE)[:6].tolist():
        world.show({thing: int(rng.integers(PER_PLACE))}, 10, still=False)
        world.show({}, 10, still=False)
    assert not world.wrong()
    things = np.array(world.things)
    alone = np.flatnonzero(np.sum(things[known:] != NO_TRUTH, axis=1) == 1) + known
    assert len(alone) == 60


def test_whatever_happens_hardly_anything_is_taken_for_another():
    """Things come, go, change places and are moved at random, over cuts and before a still image.

    Looks are as different as random ones are; two of forty may yet look alike by chance.
    """
    wrong = num = 0
    for seed, size in itertools.product(range(8), (0.3, 0.6, 1.0)):
        rng = np.random.default_rng([seed, int(10 * size)])
        world = World(rng, int(rng.integers(1, 40)), float(rng.choice([0.05, 0.1, 0.2])), size)
        placed: dict[int, int] = {}
        while len(world.things) < 90:
            placed = happen(rng, placed, world.num_things)
            world.show(placed, still=bool(rng.integers(2)))
            world.show(placed, int(rng.choice([0, 1, 2, 4, 7, 11, 19])))
        del world.seen[90:], world.motions[90:], world.things[90:]
        wrong += len(world.wrong())
        num += sum(int(np.sum(row != NO_TRUTH)) for row in world.things)
    assert num > 5000
    assert wrong <= num / 150


def happen(rng: np.random.Generator, placed: dict[int, int], num: int) -> dict[int, int]:
    """What is where after something has happened at random."""
    things, places = [*placed], [*placed.values()]
    free = rng.permutation([k for k in range(PER_PLACE) if k not in places]).tolist()
    others = rng.permutation([k for k in range(num) if k not in things]).tolist()
    what = rng.choice(["nothing", "swap", "permute", "replace", "move", "go", "come", "cut"])
    if not things or what == "cut":
        count = int(rng.integers(1, min(PER_PLACE, num) + 1))
        return dict(
            zip(
                rng.permutation(num)[:count].tolist(),
                rng.permutation(PER_PLACE)[:count].tolist(),
                strict=True,
            )
        )
    one = int(rng.integers(len(things)))
    if what == "swap":
        places[one], places[0] = places[0], places[one]
    elif what == "permute":
        places = rng.permutation(places).tolist()
    elif what == "replace" and others:
        things[one] = others[0]
    elif what == "move" and free:
        places[one] = free[0]
    elif what == "go":
        del things[one], places[one]
    elif what == "come" and others and free:
        things, places = [*things, others[0]], [*places, free[0]]
    return dict(zip(things, places, strict=True))
