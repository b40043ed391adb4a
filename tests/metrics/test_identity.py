from __future__ import annotations

import numpy as np
import pytest

from remind_jax.metrics.identity import count_identity
from tests.metrics.tables import from_frames


@pytest.mark.parametrize(("overlap", "right"), [(0.5, 1), (np.nextafter(0.5, 0), 0)])
def test_a_half_is_enough(overlap: float, right: int):
    sequence = from_frames([[1]], [[1]], [[[overlap]]])
    assert count_identity(sequence).true_positives == right
