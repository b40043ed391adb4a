"""Structured text becomes a record, or is refused in a sentence that names file and place."""

import json
from typing import Annotated, Any, Literal

import msgspec
import pytest
from msgspec import Meta

from remind_jax.errors import ConfigError, OutputError, SourceError
from remind_jax.files import limits
from remind_jax.files.records import (
    Label,
    Whole,
    check,
    decode_json,
    decode_rows,
    read_json,
    read_yaml,
)


class Part(msgspec.Struct, forbid_unknown_fields=True):
    number: Annotated[int, Meta(ge=0, le=5)]
    score: float = 0.0
    label: Label = ""
    kind: Literal["new", "old"] = "new"
    sides: Annotated[list[Whole], Meta(max_length=3)] = []
    key: Whole | Label | None = None
    named: dict[str, float] = {}


def test_a_refusal_names_the_place():
    refused = {
        '[{"number": 1.5}]': "[0].number",
        '[{"number": true}]': "[0].number",
        '[{"number": 1}, {}]': "number",
        '[{"number": 1, "nummer": 1}]': "nummer",
        '[{"number": 1, "score": NaN}]': "invalid",
        '[{"number": 1, "score": 1e999}]': "out of range",
        '[{"number": 1, "kind": "odd\\u001b[31m"}]': "[0].kind",
        '[{"number": 1, "sides": [1, 2, 3, 4]}]': "[0].sides",
        '[{"number": 1, "key": 10000000000000000000}]': "[0].key",
        '[{"number": 1, "named": {"a": "b"}}]': "named",
        '{"number": 1}': "array",
        '[{"number": 1}': "truncated",
        '[{"number": 1}] x': "trailing",
        "": "truncated",
        json.dumps([{"number": 1, "label": "x" * (limits.MAX_LABEL + 1)}]): "[0].label",
        '[{"number": 1, "number": 2}]': '"number" stands twice',
        "[" * 100_000 + "]" * 100_000: "",
    }
    for text, place in refused.items():
        with pytest.raises(SourceError) as caught:
            decode_json(text.encode(), list[Part], "'x'")
        assert str(caught.value).startswith("'x'"), text[:80]
        assert place in str(caught.value), text[:80]


def test_files_that_are_no_json(tmp_path):
    for data in (None, "[]".encode("utf-16"), b'["caf\xe9"]'):
        if data is not None:
            (tmp_path / "a.json").write_bytes(data)
        with pytest.raises(OutputError, match=r"a\.json"):
            read_json(tmp_path / "a.json", list[str], refused=OutputError)
    (tmp_path / "a.json").write_bytes(b'\xef\xbb\xbf{"number": 3}')
    assert read_json(tmp_path / "a.json", Part).number == 3


def test_a_bad_row_spoils_no_other():
    text = b'[{"number": 1}, {"number": 9}, 3, {"number": 2}, {"number": 1, "number": 2}]'
    raws = decode_json(text, list[msgspec.Raw], "x")
    rows = list(decode_rows(raws, Part, "'x'"))
    assert [row.record and row.record.number for row in rows] == [1, None, None, 2, None]
    assert str(rows[1].error).startswith("'x', row 2: ")
    with pytest.raises(SourceError, match="row 3"):
        rows[2].get()


def test_yaml_is_plain_and_small(tmp_path):
    laughing = ["a0: &a0 [x, x]"]
    laughing += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 25)]
    for text in (
        *("a: 1\na: 2", "!!python/object:os.system {}", "a: [", "[" * 5000, "a: .nan"),
        *("a: 2020-99-99", "- 1", "a: &x\n b: *x", "a: 100000000000000000000", "1: 2"),
        "#" * (limits.MAX_YAML_BYTES + 1),
        "\n".join(laughing),
    ):
        (tmp_path / "a.yaml").write_text(text)
        with pytest.raises(ConfigError, match=r"a\.yaml"):
            read_yaml(tmp_path / "a.yaml", dict[str, Any], refused=ConfigError)
    (tmp_path / "a.yaml").write_text("# nothing\n")
    assert read_yaml(tmp_path / "a.yaml", dict[str, Any]) == {}


def test_mappings_are_checked_alike():
    for value, place in (
        ({"number": 1, "score": float("nan")}, "`score`"),
        ({"number": 1, "named": {"a": float("inf")}}, "`named.a`"),
        ({"number": 10**30}, "`number`"),
        ({"number": 1, "named": {"a": "\ud800"}}, "`named.a`"),
        ({"number": "1"}, "number"),
    ):
        with pytest.raises(SourceError, match=place):
            check(value, Part, "'x'")
    assert check({"number": 2, "sides": (1, 2)}, Part, "'x'") == Part(2, sides=[1, 2])


def test_totals_are_compared_before_decoding():
    for part, what in ((b"{},", "mappings"), (b"1,", "items")):
        with pytest.raises(SourceError, match=what):
            decode_json(b"[" + part * 31_000_000 + b"1]", list[Any], "'x'")


def test_keys_that_stand_twice():
    for text, key in (
        ('{"a": 1, "b": {"c": [{"d": 1}, {"d": 2, "d": 3}]}}', "d"),
        ('{"a": 1, "b": 2, "\\u0061": 2}', "a"),
        ('{"a": "{:\\"", "a": "]"}', "a"),
    ):
        with pytest.raises(SourceError, match=f'"{key}" stands twice'):
            decode_json(text.encode(), dict[str, Any], "'x'")
    text = b'{"a": {"a": 1}, "b": [{"a": 1}, {"a": 2}]}'
    assert decode_json(text, dict[str, Any], "'x'")["b"] == [{"a": 1}, {"a": 2}]
