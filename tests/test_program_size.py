"""The size of the compiled programs, on which start, memory and speed hang, is held."""

from __future__ import annotations

import jax
import pytest

from benchmarks.program import count_instructions, measure, programs_of
from remind_jax.method import get_method

MEASURED_WITH = "0.10.2"  # version of JAX
SLACK = 0.05
SIZES = {
    "plus": {
        "describe": {"equations": 239, "fusions": 25, "loops": 0},
        "decide": {"equations": 5566, "fusions": 321, "loops": 9},
    },
    "remind": {
        "describe": {"equations": 1349, "fusions": 120, "loops": 8},
        "decide": {"equations": 16557, "fusions": 873, "loops": 28},
    },
    "momentum": {"step": {"equations": 569, "fusions": 67, "loops": 6}},
    "running-mean": {"step": {"equations": 454, "fusions": 61, "loops": 7}},
    "bank": {"step": {"equations": 1129, "fusions": 117, "loops": 13}},
    "iou": {"step": {"equations": 890, "fusions": 63, "loops": 6}},
}


@pytest.mark.skipif(jax.__version__ != MEASURED_WITH, reason="counts depend on the compiler")
@pytest.mark.parametrize("name", SIZES)
def test_programs_grow_no_larger(name, optimized):
    method = get_method(name)
    for part, function, arguments in programs_of(method, traced=False):
        row = measure(part, method, function, arguments).row
        for count, before in SIZES[name][part].items():
            assert row[count] <= (1 + SLACK) * before, (part, count)
            # A program that became smaller is good news that belongs here.
            assert row[count] >= (1 - SLACK) * before, (part, count)


PROGRAM = """HloModule jit_f

FileNames
1 "/home/me/remind_jax/plus/learning.py"
2 "/lib/jax/numpy.py"

FunctionNames
1 "learn"

FileLocations
1 {file_name_id=1 function_name_id=1 line=7}
2 {file_name_id=2 function_name_id=1 line=9}

StackFrames
1 {file_location_id=1 parent_frame_id=1}
2 {file_location_id=2 parent_frame_id=1}

%fused_computation (p: f32[2]) -> f32[2] {
  %p = f32[2]{0} parameter(0)
  ROOT %s = f32[2]{0} sine(%p), metadata={op_name="sin" stack_frame_id=2}
}

ENTRY %main (a: f32[2]) -> (f32[2], s32[]) {
  %a = f32[2]{0} parameter(0)
  %f = f32[2]{0} fusion(%a), kind=kLoop, calls=%fused_computation, metadata={stack_frame_id=2}
  %w = (f32[2]{0}, s32[]) while(%f), condition=%c, body=%b
  ROOT %t = (f32[2]{0}, s32[]) tuple(%f, %w)
}
"""


def test_instructions_are_counted_where_they_come_from():
    kinds, modules, lines = count_instructions(PROGRAM)
    assert kinds == {"fusion": 1, "while": 1}
    assert modules == {"plus/learning.py": 1, "no place recorded": 1}
    assert lines["plus/learning.py:7"] == 1
