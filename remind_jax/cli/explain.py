"""`remind explain`: why one detection became what it became."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from remind_jax.cli.flags import flags
from remind_jax.errors import OutputError
from remind_jax.printing.terminal import output_width, printable

if TYPE_CHECKING:
    from remind_jax.outputs.result import Result


@flags
class Explain:
    """Say in words why a detection became what it became.

    The run must have been made with --trace.

    Without --detection, the detections of the frame are listed.

    Examples:
      remind run rooms.mp4 --detector yolo11n-seg.onnx --trace
      remind explain runs/rooms --frame 42
      remind explain runs/rooms --frame 42 --detection 3
      remind explain runs/rooms --frame 42 --detection 3 --json
    """

    run: Annotated[Positional[Path], arg(metavar="RUN")]  # output folder of a run
    frame: Annotated[int, arg(metavar="T")]  # number of the frame, as in overlay and report
    detection: Annotated[int | None, arg(metavar="I")] = None  # row in the frame, from 0
    json: bool = False  # print JSON; its keys are described in docs/explain.md

    def execute(self) -> None:
        """Prints the explanation."""
        from remind_jax.outputs.result import Result

        result = Result.load(self.run)
        if result.trace is None:
            hint = "" if result.complete else "go on with it (--resume) if it was begun so, or "
            raise OutputError(f"'{self.run}' holds no trace; {hint}run again with --trace")
        if self.detection is None:
            self._list(result)
            return
        explanation = result.explain(self.frame, self.detection)
        if self.json:
            print(json.dumps(explanation.to_json(), indent=1, ensure_ascii=False))
        else:
            print(printable(explanation.to_text(output_width())))

    def _list(self, result: Result) -> None:
        """Prints the detections of the frame."""
        from remind_jax.explanation.explainer import find_frame
        from remind_jax.explanation.explanation import render_frame
        from remind_jax.outputs.run_records import tracks_to_json

        tracks = find_frame(result.tracks, self.frame)
        if self.json:
            print(json.dumps(tracks_to_json(tracks), indent=1, ensure_ascii=False))
        else:
            print(printable(render_frame(tracks)))
