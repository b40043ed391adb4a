"""A bench without a tracker: scores are a formula of the setting, so searches are checkable."""

import dataclasses
import math
from collections.abc import Callable, Sequence

from remind_jax.sweeps.records import Row
from remind_jax.sweeps.result import SweepResult
from remind_jax.sweeps.settings import Setting


@dataclasses.dataclass
class FakeBench:
    """Scores `formula(setting, scene number)`; keeps what it was asked."""

    formula: Callable[[Setting, int], dict[str, float]]
    scenes: tuple[str, ...] = ("a", "b")
    asked: list[list[Setting]] = dataclasses.field(default_factory=list)
    stop_after: int = 1_000_000  # calls
    tracker: str = "remind"  # whose thresholds the formula is about

    def run(self, settings: Sequence[Setting]) -> SweepResult:
        if len(self.asked) >= self.stop_after:
            return SweepResult((), self.scenes, (), 0, 0, complete=False)
        self.asked.append(list(settings))
        rows = tuple(
            tuple(
                Row("", scene, dict(setting), self.formula(setting, "abcdef".index(scene)))
                for scene in self.scenes
            )
            for setting in settings
        )
        return SweepResult(tuple(dict(s) for s in settings), self.scenes, rows, 4, 0)

    def find_fault(self, setting: Setting) -> str:
        """As of thresholds of which one may not be above the other."""
        return "low is above high" * (setting.get("low", 0) > setting.get("high", 1))

    def complete_space(self, space):
        """Everything is allowed, as it is."""
        return space


def hill(setting: Setting, scene: int) -> dict[str, float]:
    """Best at match 0.7, lock 0.9 with the gate on; each scene a little to the side."""
    match = setting.get("matching.match", 0.55)
    lock = setting.get("matching.lock_score", 0.8)
    gate = setting.get("influence.enabled", False)
    off = (match - 0.7 - 0.01 * scene) ** 2 + 0.3 * (lock - 0.9) ** 2
    score = math.exp(-30 * off) - (0 if gate else 0.1)
    doubt = abs(match - 0.5)
    return {"IDF1": score, "Ambiguous": doubt, "Firm": 1.0 - doubt, "HardRecovery": math.nan}
