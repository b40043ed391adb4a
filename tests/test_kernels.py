"""The profile of a frame: kernels counted, without what runs within them, and found in the code."""

import jax
import jax.numpy as jnp

from benchmarks.kernels import Kernel, make_rows, record, sum_events
from benchmarks.program import count_instructions

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


def event(name, start_us, lasts_us, thread=1):
    args = {"hlo_module": "jit_f", "hlo_op": name}
    return {"ph": "X", "tid": thread, "ts": start_us, "dur": lasts_us, "name": name, "args": args}


def test_what_runs_within_a_loop_is_not_counted_in_it():
    events = [
        event("w", 0, 10000),
        event("f", 1000, 2000),
        event("f", 4000, 3000),
        event("f", 4000, 1000, thread=2),
        {"ph": "X", "tid": 1, "ts": 0, "dur": 5, "name": "no kernel"},
    ]
    assert sum_events(events) == [Kernel("jit_f", "f", 3, 6.0), Kernel("jit_f", "w", 1, 5.0)]


def test_kernels_are_found_in_the_code():
    kernels = [Kernel("jit_f", "f", 4, 6.0), Kernel("jit_f", "w", 2, 1.0)]
    rows = list(make_rows(kernels, [PROGRAM], num_frames=2, most=1))
    assert [(row["name"].strip(), row["kernels"], row["ms"]) for row in rows] == [
        ("all kernels", 3.0, 3.5),
        ("fusion", 2.0, 3.0),
        ("plus/learning.py", 2.0, 3.0),
        ("plus/learning.py:7", 2.0, 3.0),
        ("jit_f f (plus/learning.py:7)", 2.0, 3.0),
    ]


def test_kernels_of_real_programs_are_recorded():
    @jax.jit
    def rank_products(x):
        return jnp.sort(x @ x)

    x = jax.block_until_ready(rank_products(jnp.ones((8, 8))))
    with record() as recording:
        for _ in range(3):
            jax.block_until_ready(rank_products(x))
    ran = [kernel for kernel in recording.kernels if kernel.program == "jit_rank_products"]
    assert ran
    assert all(kernel.runs % 3 == 0 and kernel.milliseconds >= 0 for kernel in ran)


def test_instructions_are_counted_where_they_come_from():
    kinds, modules, lines = count_instructions(PROGRAM)
    assert kinds == {"fusion": 1, "while": 1}
    assert modules == {"plus/learning.py": 1, "no place recorded": 1}
    assert lines["plus/learning.py:7"] == 1
