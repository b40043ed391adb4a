from __future__ import annotations

from remind_jax.benchmark.records import Record, read_record, write_record


def test_records_come_back_as_they_were(tmp_path):
    times_ms = {"frame_ms": 3.0, "frame_p95_ms": 4.0}
    record = Record("bank", "room", "masks", "abc", "done", "", 1, 9, times_ms, 80.5)
    write_record(tmp_path, record)
    assert read_record(tmp_path) == record
    (tmp_path / "record.json").write_text('{"contender": "bank"}')
    assert read_record(tmp_path) is None
