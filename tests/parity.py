"""Agreement with the original tracker on golden sequences.

    python tests/parity.py FOLDER [--names a,b] [--variants core,default]
        [--precision float64|float32] [--only FIELD] [--json OUT] [--min 1.0]

Runs our tracker on every golden sequence of a folder (format: `tests/golden/README.md`) and
prints, per trace, how many decisions agree, the first difference, and how far the state of the
objects agrees. Exit status 1 if any trace agrees less than `--min`.
"""

import argparse
import dataclasses
import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from remind_jax.compiled.frame_step import FrameInput, FrameStep, pack_thresholds
from remind_jax.compiled.packing import Bundle, Packed
from remind_jax.compiled.programs import clear_programs
from remind_jax.config import Config
from remind_jax.decision import Outcome, Reason, Status
from remind_jax.masks.reduction import reduce_masks
from remind_jax.method import get_method
from remind_jax.observation import FrameFeats
from remind_jax.remind.association.gating import Gate
from remind_jax.remind.memory.objects import Lifecycle
from remind_jax.remind.memory.pending import Kind
from remind_jax.remind.perception.description import describe
from remind_jax.remind.stages import Lock, MatchOrigin
from remind_jax.remind.state import init
from tests.golden import load

# Scores: the original's are float64 on float32 cosines; summation order alone moves them by 1e-7.
SCORE_TOLERANCE = {"float64": 2e-6, "float32": 2e-5}
CONFIDENCE_TOLERANCE = {"float64": 1e-5, "float32": 2e-4}  # steep in the gap: slope up to 20
DESCRIPTOR_TOLERANCE = 1e-5

OUTCOMES = {"AMBIGUOUS": "AMBIGUOUS_TRACK"}  # what the original calls otherwise than we do
# Compiled programs of more traces take more mappings of memory than systems allow a process.
TRACES_AT_ONCE = 16

BANKS = {  # column of the trace: leaf of the state, channel, bank
    f"{name}_{bank}": (leaf, channel, bank)
    for name, leaf, channel in (
        ("global", "wholes", 0),
        ("trimmed", "wholes", 1),
        ("parts", "parts", 0),
        ("inner", "wholes", 2),
        ("outer", "wholes", 3),
        ("inner_partials", "ring_prototypes", 0),
        ("outer_partials", "ring_prototypes", 1),
    )
    for bank in ("work", "stable")
}


@dataclasses.dataclass
class Report:
    """Agreement of one trace."""

    name: str
    variant: str
    precision: str
    compared: int = 0  # detections
    agreeing: int = 0  # detections with the original's outcome and identity
    only: str | None = None  # field whose first difference is wanted; any if left out
    first: str = ""  # first difference of that field
    outcomes: dict[str, int] = dataclasses.field(default_factory=dict)
    fields: dict[str, list[int]] = dataclasses.field(default_factory=dict)  # agreeing, compared

    @property
    def agreement(self) -> float:
        return self.agreeing / max(1, self.compared)

    def note(self, frame: int, what: str, field: str, ours: Any, theirs: Any, same: bool) -> bool:
        agreeing, compared = self.fields.setdefault(field, [0, 0])
        self.fields[field] = [agreeing + bool(same), compared + 1]
        if not same and not self.first and self.only in (None, field):
            self.first = f"frame {frame}, {what}: {field} is {ours}, the original has {theirs}"
        return bool(same)


def run_sequence(name: str, trace: load.Trace, precision: str, root: Path):
    """Yields per frame: frame index, ids of the kept detections, the state, and the stages."""
    config = Config.from_reference(trace.info["override"])
    ignored = {label.lower() for label in config.input.ignored_classes}
    scene = load.Scene(name, root)
    most = int((scene.order != load.NO_LABEL).sum(axis=1).max())
    static = dataclasses.replace(
        config.static,
        feature_dim=scene.dim,
        precision=precision,
        num_detections=max(1, most),
        num_objects=int(trace.frame["n_object"].max()) + 8,
        num_pending=max(8, len(set(zip(trace.temp["track"], trace.temp["temp"], strict=True))) + 8),
    )
    # The programs that users run, but that they give the stages of the decisions as well.
    method = get_method("remind")

    def decide(*given, **options):
        state, trace = method.decide(*given, **options)
        return state, trace.stages

    told = dataclasses.replace(method, decide=decide)
    step, memory = FrameStep(told, traced=True), Bundle.of(init(static))
    thresholds = pack_thresholds(config.thresholds, static.scalar)
    for frame, (features, masks, classes) in enumerate(load.load_inputs(name, root)):
        kept = [i for i, label in enumerate(classes) if label.lower() not in ignored]
        reduced = reduce_masks(
            masks[kept],
            np.array([trace.info["classes"].index(classes[i]) for i in kept], np.int32),
            np.ones(len(kept)),
            num_slots=static.num_detections,
            patch_px=load.PATCH,
            sanitize=config.input.sanitize,
            fill_holes=config.input.fill_holes,
            close_px=config.input.close_px,
            open_px=config.input.open_px,
            keep_largest=config.input.keep_largest,
            erosion_px=config.input.erosion_px,
        )
        feats = FrameFeats(features, np.array(masks.shape[1:], np.int32))
        given = FrameInput(feats, Packed.of((reduced, None)), thresholds)
        memory, _, stages = step.decide(memory, step.describe(given, static))
        yield frame, kept, feats, reduced, memory.read(), stages, static, config


def compare_trace(
    name: str, variant: str, precision: str, root: Path, only: str | None = None
) -> Report:
    """Runs one sequence under one variant and compares it with the recorded trace."""
    trace = load.load_trace(name, variant, root)
    report = Report(name, variant, precision, only=only)
    for frame, kept, feats, reduced, state, stages, static, config in run_sequence(
        name, trace, precision, root
    ):
        _compare_detections(report, trace, frame, kept, state, stages, precision)
        _compare_objects(report, trace, frame, state)
        _compare_pending(report, trace, frame, state)
        if "desc" in trace.tables and frame % 10 == 0:
            _compare_descriptors(report, trace, frame, kept, feats, reduced, static, config)
    return report


def _compare_detections(report, trace, frame, kept, state, stages, precision) -> None:
    told = {**vars(state.decisions), **vars(stages)}
    d = SimpleNamespace(**{name: np.asarray(values) for name, values in told.items()})
    first_row = int(np.searchsorted(trace.det["frame"], frame))
    rows = trace.rows("det", frame=frame)
    if list(rows["det"]) != kept:
        raise ValueError(f"frame {frame}: detections {kept} against {list(rows['det'])}")
    score_tolerance = SCORE_TOLERANCE[precision]
    for i, det in enumerate(kept):
        row = {column: values[i] for column, values in rows.items()}
        what = f"detection {det}"

        def code(vocabulary: str, column: str, row=row) -> str:
            return trace.name(vocabulary, row[column])

        def exact(field: str, ours: Any, theirs: Any, what=what) -> bool:
            return report.note(frame, what, field, ours, theirs, ours == theirs)

        def close(field: str, ours: float, theirs: float, tolerance: float, what=what) -> bool:
            same = abs(float(ours) - float(theirs)) <= tolerance
            return report.note(frame, what, field, ours, theirs, same)

        outcome = Outcome(d.outcome[i]).name
        outcome = OUTCOMES.get(outcome, outcome)
        report.outcomes[outcome] = report.outcomes.get(outcome, 0) + 1
        report.compared += 1
        same = exact("outcome", outcome, code("outcome", "outcome"))
        same &= exact("object", int(d.object_id[i]), int(row["object"]))
        report.agreeing += same
        exact("reason", Reason(d.reason[i]).name, code("reason", "reason"))
        exact("temp", int(d.pending_id[i]), int(row["temp"]))
        exact("source", MatchOrigin(d.source[i]).name.lower(), code("source", "source") or "none")
        exact("guarded", int(d.guarded_id[i]), int(row["guarded"]))
        exact("anchor", bool(d.is_anchor[i]), bool(row["anchor"]))
        exact("hungarian", int(d.assigned_id[i]), int(row["hungarian"]))
        exact("lock", Lock(d.lock[i]).name.lower(), code("lock", "lock"))
        exact("status", Status(d.status[i]).name, code("status", "status"))
        exact("status_final", Status(d.status_final[i]).name, code("status", "status_final"))
        exact("n_close", int(d.num_close[i]), int(row["n_close"]))
        # Among exact ties the original names the first in the order of a set of ids.
        tied = d.candidate_id[i][d.candidate_score[i] == d.candidate_score[i, 0]].tolist()
        unseen = len(tied) == len(d.candidate_id[i])  # the tie goes on beyond those shown
        named = unseen or int(row["best"]) in tied
        report.note(frame, what, "best", tied, int(row["best"]), named)
        close("score", d.score[i], row["score"], score_tolerance)
        close("s1", d.best_score[i], row["s1"], score_tolerance)
        close("s2", d.second_score[i], row["s2"], score_tolerance)
        close("confidence", d.confidence[i], row["confidence"], CONFIDENCE_TOLERANCE[precision])
        _compare_options(report, trace, frame, det, first_row + i, d, i, score_tolerance)
        candidates = trace.rows("cand", det_row=first_row + i)
        exact(
            "candidates",
            [int(c) for c in d.candidate_id[i] if c >= 0],
            [int(c) for c in candidates["object"]],
        )
        for j, theirs in enumerate(candidates["object"]):
            if int(d.candidate_id[i, j]) == int(theirs):
                sim, final = candidates["score_sim"][j], candidates["score_final"][j]
                close("cand.score_sim", d.candidate_score[i, j], sim, score_tolerance)
                close("cand.score_final", d.candidate_final[i, j], final, score_tolerance)
                eligible = bool(candidates["eligible"][j])
                exact("cand.eligible", bool(d.candidate_eligible[i, j]), eligible)
                plausible = bool(candidates["plausible"][j])
                exact("cand.plausible", bool(d.candidate_plausible[i, j]), plausible)
                gate = Gate(d.candidate_gate[i, j]).name
                exact(
                    "cand.gate", gate.replace("NONE", ""), trace.name("gate", candidates["gate"][j])
                )
                bonus = candidates["bonus"][j]
                close("cand.bonus", d.candidate_bonus[i, j], bonus, score_tolerance)


def _compare_options(report, trace, frame, det, row, d, i, tolerance) -> None:
    """Objects that an undecided detection could be, as a set with scores."""
    ours = {
        int(o): (float(v), bool(b))
        for o, v, b in zip(d.option_id[i], d.option_score[i], d.option_blocked[i], strict=True)
        if o >= 0
    }
    for table in ("amb", "prov"):
        theirs = trace.rows(table, det_row=row)
        if not len(theirs["object"]):
            continue
        ids = [int(o) for o in theirs["object"]]
        same = sorted(ours) == sorted(ids)
        report.note(frame, f"detection {det}", table, sorted(ours), sorted(ids), same)
        for object_id, score in zip(ids, theirs["score"], strict=True):
            if object_id in ours:
                near = abs(ours[object_id][0] - score) <= tolerance
                value = ours[object_id][0]
                report.note(frame, f"detection {det}", f"{table}.score", value, score, near)
        if table == "prov":
            blocked = {int(o) for o, b in zip(ids, theirs["blocked"], strict=True) if b}
            mine = {o for o, (_, b) in ours.items() if b}
            report.note(frame, f"detection {det}", "prov.blocked", mine, blocked, mine == blocked)


def _compare_pending(report, trace, frame, state) -> None:
    tracks = jax.tree.map(np.asarray, state.pending)
    ours = {
        (Kind(kind).name.lower(), int(i)): int(hits)
        for kind, i, hits in zip(tracks.kind, tracks.id, tracks.hits, strict=True)
        if kind != Kind.FREE
    }
    rows = trace.rows("temp", frame=frame)
    theirs = {
        (trace.name("track", kind), int(i)): int(hits)
        for kind, i, hits in zip(rows["track"], rows["temp"], rows["hits"], strict=True)
    }
    report.note(frame, "pending tracks", "temp", ours, theirs, ours == theirs)


def _compare_objects(report, trace, frame, state) -> None:
    objects = jax.tree.map(np.asarray, state.objects)
    rows = trace.rows("obj", frame=frame)
    slots = {int(object_id): slot for slot, object_id in enumerate(objects.id) if object_id >= 0}
    report.note(
        frame, "memory", "ids", sorted(slots), rows["object"].tolist(),
        sorted(slots) == rows["object"].tolist(),
    )  # fmt: skip
    sizes = {
        column: np.asarray(getattr(getattr(state, leaf), bank).size[channel])
        for column, (leaf, channel, bank) in BANKS.items()
        if getattr(state, leaf) is not None
    }
    graph = jax.tree.map(np.asarray, state.cooccurrence)
    degree = (graph.count > 0).sum(axis=1)
    distance_degree = (np.asarray(state.distances.edges.count) > 0).sum(axis=1)
    for i, object_id in enumerate(rows["object"].tolist()):
        slot = slots.get(object_id)
        if slot is None:
            continue
        what = f"object {object_id}"
        ours: dict[str, Any] = {
            "state": Lifecycle(objects.lifecycle[slot]).name,
            "hits": int(objects.hits[slot]),
            "misses": int(objects.misses[slot]),
            "age": int(objects.age[slot]),
            "degree": int(degree[slot]),
            "episodes": int(graph.episodes[slot]),
            "distance_degree": int(distance_degree[slot]),
            **{column: int(size[slot]) for column, size in sizes.items()},
        }
        for field, value in ours.items():
            theirs = rows[field][i]
            theirs = trace.name("state", theirs) if field == "state" else int(theirs)
            report.note(frame, what, f"obj.{field}", value, theirs, value == theirs)


def _compare_descriptors(report, trace, frame, kept, feats, reduced, static, config) -> None:
    d = jax.jit(describe, static_argnames="static")(
        feats, reduced, static=static, thresholds=config.thresholds.as_arrays(static.scalar)
    )
    ours = {
        "global": np.asarray(d.appearance[:, 0]),
        "global_trimmed": np.asarray(d.appearance[:, 1]),
        "bg_inner": np.asarray(d.rings[:, 0]),
        "bg_outer": np.asarray(d.rings[:, 1]),
    }
    rows = trace.rows("desc", frame=frame)
    for det, kind, part, vector in zip(
        rows["det"], rows["descriptor"], rows["part"], rows["vector"], strict=True
    ):
        name, slot = trace.name("descriptor", kind), kept.index(int(det))
        if name == "bg_combined":  # nothing reads it, so we do not compute it
            continue
        mine = np.asarray(d.parts[slot, 0, part]) if name == "part" else ours[name][slot]
        gap = float(np.abs(mine - vector).max())
        same = gap <= DESCRIPTOR_TOLERANCE
        report.note(frame, f"detection {det}", f"desc.{name}", f"off by {gap:.1e}", "", same)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", type=Path, help="folder with inputs/ and traces/")
    parser.add_argument("--names", help="comma-separated sequences; all if left out")
    parser.add_argument("--variants", help="comma-separated variants; all if left out")
    parser.add_argument("--precision", choices=("float64", "float32"), default="float64")
    parser.add_argument("--json", type=Path, help="write the reports to this file")
    parser.add_argument("--only", help="say the first difference of this field instead of any")
    parser.add_argument("--min", type=float, default=1.0, help="least agreement per trace")
    options = parser.parse_args(arguments)
    jax.config.update("jax_enable_x64", options.precision == "float64")

    names = options.names.split(",") if options.names else None
    variants = options.variants.split(",") if options.variants else None
    reports = []
    for name, variant in load.list_traces(options.folder):
        if (names and name not in names) or (variants and variant not in variants):
            continue
        report = compare_trace(name, variant, options.precision, options.folder, options.only)
        reports.append(report)
        if len(reports) % TRACES_AT_ONCE == 0:
            clear_programs()
            jax.clear_caches()
        state = {
            field: f"{agreeing}/{compared}"
            for field, (agreeing, compared) in report.fields.items()
            if agreeing != compared
        }
        print(
            f"{name}/{variant} {report.precision}: {report.agreeing}/{report.compared} agree"
            f" ({100 * report.agreement:.2f} %)"
            + (f"; first: {report.first}" if report.first else "; all fields agree")
            + (f"; fields: {state}" if state else ""),
            flush=True,
        )
    if options.json:
        rows = [{**dataclasses.asdict(r), "agreement": r.agreement} for r in reports]
        options.json.write_text(json.dumps(rows, indent=1))
    if not reports:
        print("no trace found", file=sys.stderr)
        return 1
    return int(any(report.agreement < options.min for report in reports))


if __name__ == "__main__":
    sys.exit(main())
