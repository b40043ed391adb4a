import jax
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.remind.context.selection import Children, number_sets, rank_choices, select_children

SETS, ROWS, MOST = 4, 6, 3  # sets of the beam, rows, most detections of a class
_rank, _select, _number = jax.jit(rank_choices), jax.jit(select_children), jax.jit(number_sets)


def allow(num_detections: int, pool_size: int, considered: int = 8) -> np.ndarray:
    """Choices that exist (method.md#class-options), by count, detection and object variant."""
    allowed = np.zeros((MOST + 1, 2, 2), bool)
    allowed[0, 0, 0] = True
    for count in range(1, min(num_detections, pool_size) + 1):
        for moved_det in range(2):
            for moved in range(2):
                det_fits = not moved_det or num_detections > count
                fits = not moved or min(pool_size, max(count, considered)) > count
                allowed[count, moved_det, moved] = det_fits and fits
    return allowed


def select_plainly(score, support, allowed, set_of, live, diverse):
    """Children in the documented order, as lists (row, count, detection and object variant)."""
    children = []
    for row in np.flatnonzero(live):
        choices = [tuple(int(index) for index in choice) for choice in np.argwhere(allowed)]
        choices.sort(key=lambda choice: -support[set_of[row], choice[0], choice[2]])
        children += [(int(row), *choice) for choice in choices]
    children.sort(key=lambda child: -score[set_of[child[0]], child[1], child[3]])
    if diverse:
        leaders = {}
        for child in children:
            leaders.setdefault(child[1], child)
        first = [leaders[count] for count in sorted(leaders, reverse=True)]
        children = first + [child for child in children if child not in first]
    return children[: len(live)]


@st.composite
def beams(draw):
    """Scores and supports of few different values, so that most of them tie."""
    value = st.sampled_from([0.0, 0.25, 0.5, 1.0])

    def table():
        size = SETS * (MOST + 1) * 2
        numbers = draw(st.lists(value, min_size=size, max_size=size))
        return np.array(numbers, np.float32).reshape(SETS, MOST + 1, 2)

    def row(element, length):
        return np.array(draw(st.lists(element, min_size=length, max_size=length)))

    support = table()
    support[:, 0] = 0
    num_live = draw(st.integers(1, ROWS))
    return (
        table(),
        support,
        allow(draw(st.integers(1, MOST)), draw(st.integers(1, MOST + 1))),
        row(st.integers(0, SETS - 1), ROWS).astype(np.int32),
        np.arange(ROWS) < num_live,
        np.bool_(draw(st.booleans())),
    )


def read_children(children: Children) -> list[tuple[int, ...]]:
    fields = (children.row, children.count, children.det_variant, children.variant)
    count = int(np.sum(children.valid))
    assert np.all(children.valid[:count])
    return [tuple(int(number) for number in child) for child in np.stack(fields, 1)[:count]]


@given(beams())
def test_children_come_in_the_documented_order(beam):
    score, support, allowed, set_of, live, diverse = beam
    order = _rank(support, allowed)
    found = jax.device_get(_select(score, order, allowed, set_of, live, diverse))
    assert read_children(found) == select_plainly(score, support, allowed, set_of, live, diverse)


@given(beams())
def test_choices_of_a_set_are_ranked_by_support_and_then_as_listed(beam):
    _, support, allowed, *_ = beam
    order = np.asarray(_rank(support, allowed))
    for one, supports in zip(order, support, strict=True):
        listed = np.argwhere(allowed)
        plain = sorted(listed.tolist(), key=lambda choice: -supports[choice[0], choice[2]])
        places = [count * 4 + moved_det * 2 + moved for count, moved_det, moved in plain]
        assert one[: len(plain)].tolist() == places
        assert sorted(one.tolist()) == list(range(support[0].size * 2))


def test_scores_of_zero_are_real_and_come_before_nothing():
    """A beam with fewer children than rows ends; those that score 0 are in it."""
    score = np.zeros((SETS, MOST + 1, 2), np.float32)
    allowed = allow(1, 1)
    live = np.arange(ROWS) < 2
    set_of = np.zeros(ROWS, np.int32)
    order = _rank(score, allowed)
    found = jax.device_get(_select(score, order, allowed, set_of, live, np.bool_(False)))
    assert read_children(found) == [(0, 0, 0, 0), (0, 1, 0, 0), (1, 0, 0, 0), (1, 1, 0, 0)]


children_lists = st.lists(
    st.tuples(st.integers(0, SETS - 1), st.integers(0, MOST), st.integers(0, 1)),
    min_size=ROWS,
    max_size=ROWS,
)


@given(children_lists, st.integers(0, ROWS))
def test_children_of_one_set_and_one_choice_share_a_set(made, num_valid):
    parent, count, variant = np.array(made, np.int32).T
    nothing = np.zeros(ROWS, np.int32)
    child = Children(nothing, count, nothing, variant, np.arange(ROWS) < num_valid)
    set_of, origin, num_sets = jax.device_get(_number(parent, child, MOST))
    different = list(dict.fromkeys(made[:num_valid]))
    assert num_sets == len(different)
    assert [different[index] for index in set_of[:num_valid]] == made[:num_valid]
    assert [made[index] for index in origin[:num_sets]] == different
    assert not np.any(set_of[num_valid:])
