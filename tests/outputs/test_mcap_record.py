"""Records are read back by the reader of the format."""

import json

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from remind_jax.errors import OutputError
from remind_jax.outputs.mcap_record import McapRecord
from tests.outputs.fake_run import make_run


@pytest.fixture(scope="module")
def run():
    return make_run()


@pytest.fixture(scope="module")
def path(run, tmp_path_factory):
    frames, result = run
    path = tmp_path_factory.mktemp("mcap") / "out.mcap"
    with McapRecord(path) as record:
        for frame, tracks in zip(frames, result.tracks, strict=True):
            record.add(frame, tracks)
    return path


@pytest.fixture(scope="module")
def messages(path):
    """Time and message, by topic."""
    found = {}
    factory = DecoderFactory()
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            decode = factory.decoder_for(channel.message_encoding, schema) or json.loads
            found.setdefault(channel.topic, []).append((message.log_time, decode(message.data)))
    return found


def test_the_schema_of_tracks_has_a_name(path):
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert "remind.Tracks" in {schema.name for schema in summary.schemas.values()}


def test_what_is_live_is_recorded_at_the_time_of_the_clock(run, tmp_path):
    frames, result = run
    with McapRecord(tmp_path / "out.mcap", 1_800_000_000.0) as record:
        record.add(frames[1], result.tracks[1])
    with (tmp_path / "out.mcap").open("rb") as file:
        times = {message.log_time for *_, message in make_reader(file).iter_messages()}
    assert times == {round(1e9 * (1_800_000_000.0 + frames[1].time_s))}


def test_times_are_those_of_the_source(messages, run):
    frames, _ = run
    assert set(messages) == {"/camera/image", "/remind/annotations", "/remind/tracks"}
    for logged in messages.values():
        assert [time for time, _ in logged] == [round(1e9 * frame.time_s) for frame in frames]


def test_tracks_are_those_of_the_run(messages, run):
    _, result = run
    for (_, said), tracks in zip(messages["/remind/tracks"], result.tracks, strict=True):
        ids = [-1 if one["id"] is None else one["id"] for one in said["detections"]]
        assert ids == tracks.object_id.tolist()
        assert [one["label"] for one in said["detections"]] == list(tracks.labels)


def test_pictures_can_be_decoded(messages, run):
    frames, _ = run
    _, picture = messages["/camera/image"][3]
    data = np.frombuffer(picture.data, np.uint8)
    decoded = cv2.imdecode(data, cv2.IMREAD_COLOR)
    assert decoded is not None
    shown = cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB)
    assert np.abs(shown.astype(int) - frames[3].image).mean() < 6


def test_outlines_enclose_the_masks(messages, run):
    _, result = run
    _, said = messages["/remind/annotations"][0]
    tracks = result.tracks[0]
    assert [text.text for text in said.texts] == [
        tracks.display_name(row) for row in range(len(tracks))
    ]
    corners = np.array([[point.x, point.y] for line in said.points for point in line.points])
    assert corners[:, 0].min() == tracks.boxes[:, 0].min()
    assert corners[:, 1].max() == tracks.boxes[:, 3].max() - 1


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(OutputError, match=r"missing/out.mcap cannot be written"):
        McapRecord(tmp_path / "missing" / "out.mcap").__enter__()
