"""Frames of very many instances stay within the memory that an input may take."""

from __future__ import annotations

import json
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from benchmarks.instances import write_inputs

ROOT = Path(__file__).resolve().parents[2]
MOST_MB = 1000  # of two GiB that an input may take
CODE = """
    import resource, sys
    from pathlib import Path
    import cv2, hotcoco, scipy.ndimage, remind_jax.session.preparation, remind_jax.sources.opening
    from benchmarks.instances import read_one
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + (2 << 30),) * 2)
    print(read_one(Path(sys.argv[1]), sys.argv[2])["taken_mb"])
"""


@pytest.mark.parametrize("masks", ["masks", "masks.json"])
def test_five_thousand_instances_fit(masks, tmp_path):
    write_inputs(tmp_path, 5000, 1280, 720)
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(CODE), str(tmp_path), masks],
        capture_output=True,
        text=True,
        cwd=ROOT,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) < MOST_MB
