"""What tells methods of one's own apart."""

import dataclasses
import functools

import jax
import numpy as np

from remind_jax.compiled.method_code import code_of
from remind_jax.method import get_method
from remind_jax.settings.method_names import find_methods


def test_results_depend_on_every_function_of_an_own_method(tmp_path):
    package, file = get_method("iou"), tmp_path / "mine.py"
    code = {}
    for text in ("def f(): return 1", "def f(): return 2"):
        file.write_text(text)
        exec(compile(text, file, "exec"), own := {})
        needs = dataclasses.replace(package.needs, observe=own["f"])
        for place in ("init", "describe", "decide", "needs"):
            made = needs if place == "needs" else own["f"]
            method = dataclasses.replace(package, **{place: made})
            code.setdefault(place, []).append(code_of(method))
        wrapped = dataclasses.replace(package, decide=jax.named_scope("mine")(own["f"]))
        code.setdefault("wrapped", []).append(code_of(wrapped))
        kept = dataclasses.replace(package, decide=functools.partial(own["f"]))
        assert code_of(kept) == code_of(kept)
    assert all(before != after for before, after in code.values())
    assert all(code_of(get_method(name)) == "" for name in find_methods())
    exec("def f(): return 1", typed := {})
    typed = dataclasses.replace(package, decide=typed["f"])
    assert code_of(typed) != code_of(typed), "nobody can tell what it was"


def test_results_depend_on_what_is_bound_to_a_function_of_an_own_method():
    package = get_method("iou")

    def within(reach):
        return dataclasses.replace(package, decide=lambda *given: (reach, given))

    codes = [code_of(within(reach)) for reach in (1, 1, 2, np.zeros(3), np.ones(3))]
    assert codes[0] == codes[1]
    assert len(set(codes)) == 4
    codes = [code_of(within(within(reach))) for reach in (1, 1, 2)]
    assert codes[0] == codes[1] != codes[2]
    calls_itself = dataclasses.replace(package, decide=lambda *given: calls_itself.init)
    assert code_of(calls_itself) == code_of(calls_itself)
    kept = [functools.partial(within(1).decide, reach=reach) for reach in (1, 1, 2)]
    codes = [code_of(dataclasses.replace(package, decide=one)) for one in kept]
    assert codes[0] == codes[1] != codes[2]


def _first(*given):
    return given


def _second(*given):
    return given[:1]


def test_functions_of_one_file_are_told_apart():
    package = get_method("iou")
    first, second = (dataclasses.replace(package, decide=decide) for decide in (_first, _second))
    assert code_of(first) == code_of(first) != code_of(second)
