"""Golden metric cases: TrackEval's own numbers on small files, and recovery worked by hand."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from remind_jax.decision import Outcome
from remind_jax.formats.mot import FileFormat, fit_texts, read_text_rows
from remind_jax.metrics.pairing import pair_scene
from remind_jax.metrics.sequence import TrackingSequence

ROOT = Path(__file__).resolve().parents[1] / "golden" / "metrics"
BOX_CASES = sorted(path.name for path in (ROOT / "boxes").iterdir())
MASK_CASES = sorted(path.name for path in (ROOT / "masks").iterdir())
ALL_CASES = [("boxes", name) for name in BOX_CASES] + [("masks", name) for name in MASK_CASES]

OUTCOMES = {  # as the original calls them
    "MATCH": Outcome.MATCH,
    "NEW": Outcome.NEW,
    "AMBIGUOUS_TRACK": Outcome.AMBIGUOUS,
    "PROVISIONAL_PARENT": Outcome.PROVISIONAL_PARENT,
    "PROVISIONAL_NEW": Outcome.PROVISIONAL_NEW,
    "UNASSIGNED": Outcome.UNASSIGNED,
}

# Sums in another order differ in the last bits; the values are at most a few thousand.
TOLERANCE = 1e-9


def read_json(path: Path) -> Any:
    return json.loads(path.read_text())


def load_case(kind: str, name: str) -> tuple[TrackingSequence, dict[str, Any]]:
    """The sequence of a case and TrackEval's numbers for it."""
    folder = ROOT / kind / name
    frames = read_json(folder / "case.json")["frames"]
    paths = folder / "gt.txt", folder / "pred.txt"
    sequence = load_texts(*paths, "mot" if kind == "boxes" else "mots", num_frames=frames)
    return sequence, read_json(folder / "expected.json")


def load_texts(
    gt_path: Path, pred_path: Path, format: FileFormat, **options: int | None
) -> TrackingSequence:
    """Two text files of one format as a sequence, read as TrackEval reads them."""
    truth = read_text_rows(gt_path, "gt", format, is_truth=True)
    prediction = read_text_rows(pred_path, "pred", format, is_truth=False)
    return pair_scene(*fit_texts(truth, prediction, **options)).sequence


def assert_same_fields(
    got: dict[str, Any], expected: dict[str, Any], but: tuple[str, ...] = ()
) -> None:
    """All expected fields, and no others, to within rounding."""
    assert set(got) == set(expected)
    for name in set(expected) - set(but):
        np.testing.assert_allclose(
            np.asarray(got[name], float), expected[name], rtol=0, atol=TOLERANCE, err_msg=name
        )
