"""Structured text becomes a record, or is refused in a sentence that helps."""

from __future__ import annotations

import json
import re
from typing import Annotated, Any, Literal

import msgspec
import pytest
from msgspec import Meta

from remind_jax.errors import ConfigError, OutputError, SourceError
from remind_jax.files import json_keys
from remind_jax.files.records import (
    MOST_LABEL,
    MOST_YAML_BYTES,
    Label,
    Whole,
    check,
    decode_json,
    decode_rows,
    read_json,
    read_json_lines,
    read_yaml,
)
from remind_jax.static import Static


class Part(msgspec.Struct, forbid_unknown_fields=True):
    number: Annotated[int, Meta(ge=0, le=5)]
    score: float = 0.0
    label: Label = ""
    kind: Literal["new", "old"] = "new"
    sides: Annotated[list[Whole], Meta(max_length=3)] = []
    key: Whole | Label | None = None
    parts: "list[Part]" = []
    named: dict[str, float] = {}


ROW = "'x', row 1"
REFUSED = {
    '[{"number": 1.5}]': f"{ROW}, `number`: found 1.5, allowed is an integer from 0 to 5; correct",
    '[{"number": true}]': "found true, allowed is an integer",
    '[{"number": -1}]': "found -1, allowed is an integer from 0 to 5",
    r'[{"number": "\u001b[31m"}]': r'found "\\u001b\[31m", allowed',
    '[{"number": 1}, {}]': "'x', row 2: `number` is missing; add it",
    '[{"number": 1, "nummer": 1}]': r"no field \"nummer\"; did you mean 'number'\?",
    '[{"number": 1, "score": NaN}]': "`score`: found NaN, allowed is a finite number",
    '[{"number": 1, "score": -Infinity}]': "found -Infinity, allowed is a finite number",
    '[{"number": 1, "score": 1e999}]': "`score`: number out of range",
    '[{"number": NaN}]': "`number`: found NaN, allowed is an integer",
    '[{"number": 1, "label": NaN}]': "`label`: found NaN, allowed is text of at most 200 charact",
    '[{"number": 1, "kind": "odd"}]': 'found "odd", allowed is one of "new", "old"',
    '[{"number": 1, "sides": [1, 2, 3, 4]}]': "found a list of 4, allowed is a list of at most 3",
    '[{"number": 1, "key": 10000000000000000000}]': "an integer of 64 bits or text .* or null",
    '[{"number": 1, "parts": [{"number": 1}, {"number": 9}]}]': r"row 1, `parts\[1\].number`: fou",
    '[{"number": 1, "named": {"a": "b"}}]': "`named`: expected `float`, got `str`",
    '{"number": 1}': "'x': found a mapping of 1, allowed is a list",
    '[{"number": 1}': "cut short",
    '[{"number": 1}] x': "not valid JSON, trailing characters .column",
    '[{"number": 1},\n x]': "invalid character .line 2, column 2",
    "": "it is empty, JSON was expected",
    "NaN": "found NaN, allowed is a list",
}


@pytest.mark.parametrize("text", REFUSED)
def test_a_refusal_names_place_value_and_what_is_allowed(text):
    with pytest.raises(SourceError, match=REFUSED[text]) as caught:
        decode_json(text.encode(), list[Part], "'x'")
    assert "\n" not in str(caught.value)
    assert "\x1b" not in str(caught.value)


@pytest.mark.parametrize("depth", [2_000, 1_000_000])
def test_deep_nesting_is_refused(depth):
    nested = b"[" * depth + b"]" * depth
    with pytest.raises(SourceError, match="nested too deep"):
        decode_json(b'{"a": ' + nested + b"}", dict[str, Any], "'x'")


@pytest.mark.parametrize("length", [MOST_LABEL, MOST_LABEL + 1])
def test_a_label_is_of_limited_length(length):
    data = json.dumps({"number": 1, "label": "x" * length}).encode()
    if length <= MOST_LABEL:
        assert decode_json(data, Part, "'x'").label == "x" * length
    else:
        with pytest.raises(SourceError, match=r"`label`: found .*, allowed is text of at most 200"):
            decode_json(data, Part, "'x'")


@pytest.mark.parametrize("data", ["[]".encode("utf-16"), b'["caf\xe9"]'])
def test_another_encoding_is_refused_by_name(data, tmp_path):
    (tmp_path / "a.json").write_bytes(data)
    with pytest.raises(OutputError, match=r"a\.json': its text is (UTF-16|not UTF-8)"):
        read_json(tmp_path / "a.json", list[str], refused=OutputError)


def test_a_byte_order_mark_is_left_out(tmp_path):
    (tmp_path / "a.json").write_bytes(b'\xef\xbb\xbf{"number": 3}')
    assert read_json(tmp_path / "a.json", Part).number == 3


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(SourceError, match=r"cannot read .*No such file"):
        read_json(tmp_path / "a.json", Part)


def test_a_bad_row_spoils_no_other():
    raws = decode_json(b'[{"number": 1}, {"number": 9}, 3, {"number": 2}]', list[msgspec.Raw], "x")
    rows = list(decode_rows(raws, Part, "'x'"))
    assert [row.record and row.record.number for row in rows] == [1, None, None, 2]
    assert str(rows[1].error).startswith("'x', row 2, `number`: found 9, allowed")
    with pytest.raises(SourceError, match="row 3: found 3, allowed is a mapping"):
        rows[2].get()


def test_lines_are_read_one_by_one(tmp_path):
    lines = (
        b'\xef\xbb\xbf{"number": 0}',
        b"",
        b'{"number": NaN}',
        b"x",
        b'{"label": "\xff"}',
        b'{"number": 1',
    )
    (tmp_path / "a.jsonl").write_bytes(b"\n".join(lines))
    rows = list(read_json_lines(tmp_path / "a.jsonl", Part))
    assert [row.number for row in rows] == [1, 3, 4, 5, 6]
    assert rows[0].get() == Part(0)
    said = [str(row.error) for row in rows[1:]]
    for text, expected in zip(
        said, ("found NaN", "not valid JSON", "not UTF-8", "cut short"), strict=True
    ):
        assert expected in text


YAML_REFUSED = {
    "a: 1\na: 2": "line 1, column 1 is not valid YAML: the key 'a' stands twice",
    "!!python/object:os.system {}": "could not determine a constructor",
    "a: [": "is not valid YAML: expected the node content",
    "[" * 5000: "nested too deep",
    "a: .nan": "`a`: found nan, give a finite number",
    "a: 2020-99-99": "month must be in",
    "- 1": "found a list of 1, allowed is a mapping",
    "a: &x\n b: *x": "it holds too much",
    "a: 100000000000000000000": "`a`: found an integer of 68 bits, at most 64",
    "1: 2": "expected `str`, got `int` as a key",
    "#" * (MOST_YAML_BYTES + 1): "it has 256 KiB, at most 256 KiB are read",
}


@pytest.mark.parametrize("text", YAML_REFUSED)
def test_yaml_is_plain_and_small(text, tmp_path):
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(ConfigError, match=YAML_REFUSED[text]):
        read_yaml(tmp_path / "a.yaml", dict[str, Any], refused=ConfigError)


def test_a_laughing_yaml_ends_at_once(tmp_path):
    lines = ["a0: &a0 [x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 25)]
    (tmp_path / "a.yaml").write_text("\n".join(lines))
    with pytest.raises(SourceError, match="it holds too much; at most 100000 values"):
        read_yaml(tmp_path / "a.yaml", dict[str, Any])


def test_an_empty_yaml_is_an_empty_mapping(tmp_path):
    (tmp_path / "a.yaml").write_text("# nothing\n")
    assert read_yaml(tmp_path / "a.yaml", dict[str, Any]) == {}


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ({"number": 1, "score": float("nan")}, "`score`: found nan, give a finite number"),
        ({"number": 1, "named": {"a": float("inf")}}, r"`named.a`: found inf"),
        ({"number": 10**30}, "found an integer of"),
        ({"number": 1, "named": {"a": "\ud800"}}, r"`named.a`: found '\\ud800', which is no text"),
        ({"number": "1"}, '`number`: found "1", allowed is an integer from 0 to 5'),
    ],
)
def test_mappings_are_checked_alike(value, said):
    with pytest.raises(SourceError, match=said):
        check(value, Part, "'x'")


def test_records_of_settings_say_what_they_expect():
    with pytest.raises(SourceError) as caught:
        decode_json(b'{"num_objects": 1e18}', Static, "'x'")
    assert str(caught.value) == (
        "'x', `num_objects`: found 1e+18 (expected `int`, got `float`); correct or remove it"
    )


def test_a_mapping_becomes_a_record():
    assert check({"number": 2, "sides": (1, 2)}, Part, "'x'") == Part(2, sides=[1, 2])


@pytest.mark.parametrize(
    ("part", "what"), [(b"{},", "4000000 mappings"), (b"1,", "30000000 items")]
)
def test_totals_are_compared_before_decoding(part, what):
    data = b"[" + part * 31_000_000 + b"1]"
    with pytest.raises(SourceError, match=f"'x' holds over {what}, which are not read; split it"):
        decode_json(data, list[Any], "'x'")


class Boxed(msgspec.Struct):
    bbox: list[float] = []
    polygons: list[list[float]] = []


TWICE = {
    '{"a": 1, "b": {"c": [{"d": 1}, {"d": 2, "d": 3}]}}': '`b.c`, row 2: the key "d" stands twice',
    '{"a": 1, "b": 2, "\\u0061": 2}': 'x\': the key "a" stands twice',
    '{"a": "{:\\"", "a": "]"}': 'x\': the key "a" stands twice',
}


@pytest.mark.parametrize("text", TWICE)
def test_a_key_that_stands_twice_is_refused_with_its_place(text):
    with pytest.raises(SourceError, match=re.escape(TWICE[text])):
        decode_json(text.encode(), dict[str, Any], "'x'")


def test_keys_of_a_mapping_are_compared_where_its_values_are_decoded_later():
    class Held(msgspec.Struct):
        names: dict[str, msgspec.Raw] = {}
        rows: list[msgspec.Raw] = []

    with pytest.raises(SourceError, match=re.escape("'x', `names`: the key \"1\" stands twice")):
        decode_json(b'{"names": {"1": "cup", "1": "mug"}}', Held, "'x'")
    held = decode_json(b'{"names": {"1": "cup"}, "rows": [{"a": 1, "a": 2}]}', Held, "'x'")
    assert len(held.rows) == 1  # a bad row spoils no other


def test_keys_of_different_mappings_may_be_the_same():
    text = b'{"a": {"a": 1}, "b": [{"a": 1}, {"a": 2}]}'
    assert decode_json(text, dict[str, Any], "'x'")["b"] == [{"a": 1}, {"a": 2}]


def test_a_row_with_a_key_twice_spoils_no_other():
    raws = decode_json(b'[{"a": 1, "a": 2}, {"a": 3}]', list[msgspec.Raw], "'x'")
    first, second = decode_rows(raws, dict[str, int], "'x'")
    assert str(first.error) == "'x', row 1: the key \"a\" stands twice; remove one"
    assert second.record == {"a": 3}


def test_beyond_some_size_keys_are_not_looked_through(monkeypatch):
    monkeypatch.setattr(json_keys, "MOST_BYTES", 10)
    assert decode_json(b'{"a": 1, "a": 2}', dict[str, Any], "'x'") == {"a": 2}


def test_one_of_many_numbers_is_no_row():
    with pytest.raises(SourceError, match=r"`bbox`, number 2: found null"):
        decode_json(b'{"bbox": [1, null]}', Boxed, "'x'")
    with pytest.raises(SourceError, match=r"`polygons`, part 1, number 2: found null"):
        decode_json(b'{"polygons": [[1, null]]}', Boxed, "'x'")
