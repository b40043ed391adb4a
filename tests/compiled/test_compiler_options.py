import logging

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.compiled import compiler_options as co
from remind_jax.compiled.programs import Recipe, clear_programs, get_program, shapes_of

LOST = {"xla_cpu_no_such_option": True}
BARRIER_STAYS = {"xla_disable_hlo_passes": "cse_barrier_expander"}


@pytest.fixture
def options(monkeypatch):
    """Options of the kind `step` on this backend, as a test wants them."""

    def choose(chosen):
        monkeypatch.setitem(co.OPTIONS, jax.default_backend(), {"step": chosen})

    monkeypatch.setattr(co, "_refused", set())
    co._known.cache_clear()
    clear_programs()
    yield choose
    co._known.cache_clear()
    clear_programs()


def run(function=jnp.sum):
    values = np.arange(4, dtype=np.float32)
    recipe = Recipe("sum", function, shapes_of([values]), repr(function), is_kept=False)
    return float(get_program(recipe)(values)[0])


def test_every_option_is_used_where_this_version_knows_it():
    for kind in ("step", "features", "network"):
        chosen = co.OPTIONS.get(jax.default_backend(), {}).get(kind, {})
        assert co.compiler_options(kind).items() <= chosen.items()
    assert co.compiler_options("plain") == {}


def test_jax_takes_them():
    doubled = jax.jit(lambda x: 2 * x, compiler_options=co.compiler_options())
    assert float(doubled(1.5)) == 3.0


def test_an_option_that_is_unknown_is_left_out_and_the_others_stay(options, caplog):
    caplog.set_level(logging.DEBUG, logger=co.__name__)
    options({"xla_backend_optimization_level": 1, **LOST})
    assert co.compiler_options() == {"xla_backend_optimization_level": 1}
    assert run() == 6.0
    assert "xla_cpu_no_such_option" in caplog.text


def test_a_value_that_is_refused_is_left_out(options):
    options({"xla_backend_optimization_level": "quick"})
    assert co.compiler_options() == {}
    assert run() == 6.0


def test_a_program_that_does_not_compile_with_them_is_compiled_plain_and_told_once(
    options, caplog, monkeypatch
):
    caplog.set_level(logging.DEBUG, logger=co.__name__)
    options({"xla_backend_optimization_level": 1})
    assert co.compiler_options()
    compile_any = jax.stages.Lowered.compile

    def fail_with_options(lowered, compiler_options=None, **rest):
        if compiler_options:
            raise jax.errors.JaxRuntimeError("UNIMPLEMENTED: Unhandled opcode")
        return compile_any(lowered, **rest)

    monkeypatch.setattr(jax.stages.Lowered, "compile", fail_with_options)
    assert run() == 6.0
    assert run(jnp.max) == 3.0
    assert co.compiler_options() == {}
    assert [record.getMessage() for record in caplog.records] == [
        "compiling without xla_backend_optimization_level: UNIMPLEMENTED: Unhandled opcode"
    ]


def test_a_program_of_which_the_compiler_refuses_an_instruction_runs_all_the_same(options):
    """On the newest versions this very option leaves what they cannot compile."""
    options(BARRIER_STAYS)
    assert run(lambda x: jnp.sum(jax.lax.optimization_barrier(2 * x))) == 12.0


def test_a_program_that_fails_plain_as_well_says_why(options, monkeypatch):
    options({"xla_backend_optimization_level": 1})
    assert co.compiler_options()

    def fail(*_, **__):
        raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: too large")

    monkeypatch.setattr(jax.stages.Lowered, "compile", fail)
    with pytest.raises(jax.errors.JaxRuntimeError, match="too large"):
        run()
    assert not co._refused
