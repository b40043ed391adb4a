"""Settings spread over eight devices give the rows of one device."""

import os
import subprocess
import sys

import numpy as np
import pytest

from remind_jax.sweeps import sweep
from tests.sweeps.tiny_sweep import CONFIG, SCENES, SETTINGS

RUN = """
import sys
import jax
import numpy as np
from remind_jax.sweeps import sweep
from tests.sweeps.tiny_sweep import CONFIG, SCENES, SETTINGS

assert jax.device_count() == 8
result = sweep(SCENES, SETTINGS, config=CONFIG, batch=3)
assert result.batch == 8  # a multiple of the devices
np.save(sys.argv[1], result.table())
"""


@pytest.mark.slow
def test_eight_devices_give_the_rows_of_one(tmp_path):
    env = os.environ | {"XLA_FLAGS": "--xla_force_host_platform_device_count=8"}
    subprocess.run(
        [sys.executable, "-c", RUN, str(tmp_path / "table.npy")], check=True, env=env, timeout=900
    )
    alone = sweep(SCENES, SETTINGS, config=CONFIG, batch=4)
    assert len(np.unique(alone.table()[:, :, 0])) > 2, "the settings must really differ"
    np.testing.assert_array_equal(np.load(tmp_path / "table.npy"), alone.table())
