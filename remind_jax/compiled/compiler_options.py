"""Options of the compiler, all of them, and compiling that never depends on them.

Options are private to a version of XLA: they come and go. One that a version does not know is left
out, and a program that cannot be compiled with the rest is compiled without any.
"""

from __future__ import annotations

import functools
import logging
from typing import Any, Literal

import jax

from remind_jax.errors import first_line

Kind = Literal["step", "features", "network", "plain"]

# Nearly all of a compilation is spent on machine code. Level 1 takes a tenth to a third off it,
# and programs are not slower for it; level 0 is several times as slow.
_LEVEL = {"xla_backend_optimization_level": 1}
# No libraries for parts of a program: what calls them cannot be fused with what is around.
_NO_LIBRARIES = {"xla_cpu_experimental_ynn_fusion_type": ""}
# By backend and kind of program; gains as measured on docs/performance.md#compiler-options.
OPTIONS: dict[str, dict[Kind, dict[str, Any]]] = {
    "cpu": {
        "step": {
            **_LEVEL,
            **_NO_LIBRARIES,
            # The older emitters of fused operations, until JAX 0.11: half of the time to compile.
            "xla_cpu_use_fusion_emitters": False,
            # Hundreds of small operations: to share each between threads costs more than it gains.
            "xla_cpu_multi_thread_eigen": False,
            # A sum over a long axis stays one kernel together with what it adds up, and what is
            # the same in all turns of a loop stays part of what reads it.
            "xla_disable_hlo_passes": "tree_reduction_rewriter,while-loop-invariant-code-motion",
        },
        "features": {**_LEVEL, **_NO_LIBRARIES},
        "network": _NO_LIBRARIES,
    },
    # Products of a step are few and small: to time kernels for each takes most of the compilation.
    "gpu": {"step": {"xla_gpu_autotune_level": 0}},
}

_log = logging.getLogger(__name__)
_refused: set[tuple[Kind, str]] = set()  # kinds that could not be compiled, by backend


def compiler_options(kind: Kind = "step") -> dict[str, Any]:
    """Options for programs of a kind on this machine, as `jax.jit` takes them; maybe none.

    Only those that this version of the compiler knows:
    `jax.jit(tracker.step, compiler_options=rj.compiler_options())`.
    """
    backend = jax.default_backend()
    if (kind, backend) in _refused:
        return {}
    return dict(_known(tuple(OPTIONS.get(backend, {}).get(kind, {}).items())))


def compile_lowered(lowered: jax.stages.Lowered, kind: Kind) -> jax.stages.Compiled:
    """Compiles with the options of a kind, or, where that fails, without any from then on."""
    if options := compiler_options(kind):
        try:
            return lowered.compile(compiler_options=options)
        except jax.errors.JaxRuntimeError as error:
            failure = error
        # What fails without options as well has another cause, and says so.
        compiled = lowered.compile()
        _refused.add((kind, jax.default_backend()))
        _log.debug("compiling without %s: %s", ", ".join(options), first_line(failure))
        return compiled
    return lowered.compile()


@functools.cache
def _known(options: tuple[tuple[str, Any], ...]) -> tuple[tuple[str, Any], ...]:
    """Those of them that this version of the compiler knows."""

    def is_known(some: tuple[tuple[str, Any], ...]) -> bool:
        try:
            jax.jit(lambda x: x).lower(0.0).compile(compiler_options=dict(some))
        except jax.errors.JaxRuntimeError as error:
            _log.debug("without %s: %s", ", ".join(name for name, _ in some), first_line(error))
            return False
        return True

    if not options or is_known(options):
        return options
    return tuple(option for option in options if is_known((option,)))
