"""Damaged, truncated and hostile logs: one clear error each, or what is left of them."""

import json
import sys

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import Writer
from pyarrow import parquet

from perception.geometry import files
from tests.twin.logs import formats
from twin.logs.fields import read_fields
from twin.logs.log import LogError

WRITERS = {
    "run.csv": formats.write_csv,
    "run.mcap": formats.write_json_mcap,
    "bag": formats.write_bag,
    "mcap_bag": lambda run, path: formats.write_bag(run, path, "mcap"),
    "dataset": formats.write_lerobot,
}
WORDS = [b"\xff" * 8, b"\0" * 8, b"\x7f" + b"\xff" * 7, b"[" * 500, b"1e999"]


@pytest.fixture(scope="module", params=WRITERS)
def written(request, tmp_path_factory):
    """A sound log, and its files with their content."""
    path = tmp_path_factory.mktemp("logs") / request.param
    WRITERS[request.param](formats.Run(1), path)
    parts = sorted(part for part in path.rglob("*") if part.is_file()) or [path]
    return path, {part: part.read_bytes() for part in parts}


@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(data=st.data())
def test_damage_is_one_error_that_names_the_log(written, data):
    path, contents = written
    part = data.draw(st.sampled_from(sorted(contents)), label="part")
    content = contents[part]
    place = data.draw(st.integers(0, len(content)), label="place")
    word = data.draw(st.one_of(st.sampled_from(WORDS), st.binary(max_size=40)), label="word")
    cut = data.draw(st.booleans(), label="cut")
    rest = b"" if cut else content[place + len(word) :]
    part.write_bytes(content[:place] + word + rest)
    try:
        read_fields(path, time="clock" if path.suffix == ".csv" else "")
    except LogError as error:
        assert str(error).startswith(f"{path}: ") and "\n" not in str(error)
    finally:
        part.write_bytes(content)


def test_a_damaged_recording_does_not_end_the_program(tmp_path):
    path = formats.write_recording(formats.Run(1), tmp_path / "run.rrd")
    content = path.read_bytes()
    path.write_bytes(content[:300] + b"\xff" * 64 + content[364:])
    with pytest.raises(LogError, match="damaged"):
        read_fields(path)
    path.write_bytes(b"RRF2" + b"\xff" * 64)
    with pytest.raises(LogError, match="damaged"):
        read_fields(path)


@pytest.mark.skipif(sys.platform != "linux", reason="Linux alone limits memory")
@pytest.mark.parametrize("kind", ["parquet", "mcap"])
def test_small_file_that_unpacks_to_much_is_refused(tmp_path, monkeypatch, kind):
    resource = pytest.importorskip("resource")
    monkeypatch.setattr(files, "LOG_MEMORY", 200 * 2**20)
    path = tmp_path / "dataset" if kind == "parquet" else tmp_path / "run.mcap"
    if kind == "parquet":
        formats.write_lerobot(formats.Run(1), path, 1)
        many = pa.table({name: np.zeros(40_000_000) for name in ("timestamp", "episode_index")})
        parquet.write_table(many, path / "data" / "chunk-000" / "file-000.parquet")
    else:
        with path.open("wb") as stream:
            writer = Writer(stream, chunk_size=2**29)
            writer.start()
            topic = writer.register_channel("/x", "json", 0)
            for _ in range(4):
                writer.add_message(topic, 0, b" " * 100_000_000 + b"1", 0)
            writer.finish()
    assert sum(each.stat().st_size for each in [path, *path.rglob("*")]) < 10_000_000
    before = resource.getrlimit(resource.RLIMIT_DATA)
    with pytest.raises(LogError, match="takes more memory"):
        read_fields(path)
    assert resource.getrlimit(resource.RLIMIT_DATA) == before
    np.zeros(60_000_000)  # and it can be taken again


@pytest.mark.skipif(sys.platform != "linux", reason="Linux alone limits memory")
def test_a_log_is_read_piece_by_piece(tmp_path, monkeypatch):
    """200 MB of messages, of which the numbers take 2 MB."""
    monkeypatch.setattr(files, "LOG_MEMORY", 100 * 2**20)
    path = tmp_path / "run.mcap"
    words = "x" * 10_000
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        topic = writer.register_channel("/x", "json", 0)
        for tick in range(20_000):
            message = {"data": tick, "words": words}
            writer.add_message(topic, tick, json.dumps(message).encode(), tick)
        writer.finish()
    np.testing.assert_array_equal(read_fields(path)["/x.data"].values, np.arange(20_000.0))


def test_images_clouds_and_words_take_no_columns(tmp_path):
    path = tmp_path / "run.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        topic = writer.register_channel("/cloud", "json", schema)
        words = writer.register_channel("/words", "json", schema)
        for tick in range(3):
            message = {"points": [0.5] * 20_000, "pixels": [[1, 2]] * 20_000, "count": tick}
            writer.add_message(topic, tick, json.dumps(message).encode(), tick)
            writer.add_message(words, tick, b'{"data": "hello"}', tick)
            writer.add_message(words, tick, b'"hello"', tick)
        writer.finish()
    fields = read_fields(path)
    assert list(fields) == ["/cloud.count"]
    assert fields["/cloud.count"].values.tolist() == [0.0, 1.0, 2.0]


def test_a_message_may_be_nested_mixed_and_change_its_layout(tmp_path):
    messages = [
        {"a": [1, "x", {"b": None}], "deep": {"c": {"d": {"e": {"f": [[2.5]]}}}}},
        {"a": [3, "y", {"b": 4}], "name": ["left", "right"], "effort": [5, None]},
        {"name": ["right", "left"], "effort": [6, 7], "stamp": 8.5},
        {"well": {"n": {"e": {"s": {"t": {"e": {"d": {"too": {"deep": 1}, "last": 9}}}}}}}},
    ]
    path = tmp_path / "run.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        topic = writer.register_channel("/x", "json", 0)
        for tick, message in enumerate(messages):
            writer.add_message(topic, tick * 10**9, json.dumps(message).encode(), 0)
        writer.finish()
    none = float("nan")
    expected = {
        "/x.a[0]": [1, 3, none, none],
        "/x.a[2].b": [none, 4, none, none],
        "/x.deep.c.d.e.f[0][0]": [2.5, none, none, none],
        "/x.effort[left]": [none, 5, 7, none],
        "/x.effort[right]": [none, none, 6, none],
        "/x.well.n.e.s.t.e.d.last": [none, none, none, 9],
    }
    fields = read_fields(path)
    assert set(fields) == set(expected)
    for name, values in expected.items():
        np.testing.assert_array_equal(fields[name].values, values)
        np.testing.assert_allclose(fields[name].stamps, [0.0, 1.0, 8.5, 3.0])
