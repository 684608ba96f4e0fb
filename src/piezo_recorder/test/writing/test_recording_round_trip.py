# SPDX-License-Identifier: BSD-3-Clause
import hashlib
import re
import tempfile
from pathlib import Path

import mcap.reader
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from piezo_recorder.reading.reader import read_recording, sha256_of
from piezo_recorder.reading.recording import RecordingError
from piezo_recorder.sample_block import TYPE_NAME, Flag
from piezo_recorder.writing.message_definition import MessageDefinition
from piezo_recorder.writing.writer import RecordingWriter

TOPIC = "/stage/samples"
MESSAGE_FILE = Path(__file__).parents[3] / "piezo_interfaces" / "msg" / "SampleBlock.msg"


def test_samples_are_read_back_to_the_bit(tmp_path, sample_blocks, ten_blocks):
    blocks, voltage_v, displacement_um = ten_blocks
    path = sample_blocks.write(
        tmp_path / "run", {TOPIC: blocks}, attachments=[("model.json", b'{"a": 1}')])
    for source in (path, path / "run_0.mcap"):
        recording = read_recording(source)
        assert np.array_equal(recording.voltage_v, voltage_v)
        assert np.array_equal(recording.displacement_um, displacement_um)
        assert np.array_equal(recording.sample_index, np.arange(400))
        assert np.array_equal(recording.flags, np.full(400, 16))
        assert recording.flags.dtype == np.uint32
        assert recording.sample_period_s == 2.5e-5
        assert recording.time_s == pytest.approx(2.5e-5 * np.arange(400))
        assert recording.gaps == []
        assert recording.complete
        assert recording.attachments == {"model.json": b'{"a": 1}'}


def test_recording_made_before_stages_had_several_axes_is_read(tmp_path, sample_blocks):
    older = get_typestore(Stores.ROS2_JAZZY)
    older.register(get_types_from_msg(
        re.sub(r"^string\[\] axes[^$]*", "", MESSAGE_FILE.read_text(), flags=re.M), TYPE_NAME))
    assert "axes" not in older.types[TYPE_NAME].__annotations__
    header = older.types["std_msgs/msg/Header"](
        older.types["builtin_interfaces/msg/Time"](0, 0), "stage")
    block = older.types[TYPE_NAME](
        header=header, first_sample=0, sample_period_s=2.5e-5, tick=1, voltage_v=np.arange(40.0),
        displacement_um=np.arange(40.0), flags=16, missed_feedback=0)
    text, _ = older.generate_msgdef(TYPE_NAME, ros_version=2)
    with RecordingWriter(tmp_path / "run") as writer:
        channel = writer.add_topic(TOPIC, MessageDefinition(
            TYPE_NAME, text, older.hash_rihs01(TYPE_NAME)))
        writer.write(channel, bytes(older.serialize_cdr(block, TYPE_NAME)), 0)
    recording = read_recording(tmp_path / "run")
    assert recording.axes == () and np.array_equal(recording.voltage_v, np.arange(40.0))


def test_rosbags_decodes_it_from_the_embedded_definition(tmp_path, sample_blocks, ten_blocks):
    blocks, voltage_v, _ = ten_blocks
    path = sample_blocks.write(tmp_path / "run", {TOPIC: blocks})
    with AnyReader([path]) as reader:
        messages = [reader.deserialize(data, connection.msgtype)
                    for connection, _, data in reader.messages()]
        assert reader.message_count == 10
        assert reader.topics[TOPIC].msgtype == TYPE_NAME
    assert np.array_equal(np.concatenate([message.voltage_v for message in messages]), voltage_v)


def test_mcap_alone_reads_messages_definition_and_attachments(
        tmp_path, sample_blocks, ten_blocks):
    path = sample_blocks.write(
        tmp_path / "run", {TOPIC: ten_blocks[0]}, attachments=[("parameters.yaml", b"a: 1\n")])
    with open(path / "run_0.mcap", "rb") as stream:
        reader = mcap.reader.make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        messages = list(reader.iter_messages())
        assert [message.data for _, _, message in messages] == ten_blocks[0]
        schema, channel, _ = messages[0]
        assert (schema.name, schema.encoding) == (TYPE_NAME, "ros2msg")
        assert schema.data.decode() == sample_blocks.definition.text
        assert (channel.topic, channel.message_encoding) == (TOPIC, "cdr")
        attachment, = reader.iter_attachments()
        assert (attachment.name, attachment.data) == ("parameters.yaml", b"a: 1\n")


def test_metadata_file_describes_the_recording(tmp_path, sample_blocks, ten_blocks):
    path = sample_blocks.write(tmp_path / "run", {TOPIC: ten_blocks[0]})
    text = (path / "metadata.yaml").read_text(encoding="utf-8")
    metadata = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert metadata["version"] == 9
    assert metadata["storage_identifier"] == "mcap"
    assert metadata["relative_file_paths"] == ["run_0.mcap"]
    assert metadata["message_count"] == 10
    assert metadata["duration"] == {"nanoseconds": 9_000_000}
    topic, = metadata["topics_with_message_count"]
    assert topic["topic_metadata"]["name"] == TOPIC
    assert topic["topic_metadata"]["type_description_hash"].startswith("RIHS01_")
    assert "&" not in text and "*" not in text


def test_an_existing_recording_is_never_overwritten(tmp_path, sample_blocks, ten_blocks):
    path = sample_blocks.write(tmp_path / "run", {TOPIC: ten_blocks[0]})
    before = {file.name: file.read_bytes() for file in path.iterdir()}
    with pytest.raises(FileExistsError, match="exists already and is not overwritten"):
        RecordingWriter(path)
    assert {file.name: file.read_bytes() for file in path.iterdir()} == before


def test_closing_twice_changes_nothing(tmp_path, ten_blocks, sample_blocks):
    with RecordingWriter(tmp_path / "run") as writer:
        channel = writer.add_topic(TOPIC, sample_blocks.definition)
        writer.write(channel, ten_blocks[0][0], 5)
        writer.close()
    assert len(read_recording(writer.path).voltage_v) == 40


@settings(deadline=None, max_examples=50)
@given(cuts=st.sets(st.integers(1, 399)))
def test_any_split_into_blocks_gives_the_same_arrays(sample_blocks, cuts):
    voltage_v = np.linspace(-20, 120, 400)
    displacement_um = voltage_v ** 2
    bounds = [0, *sorted(cuts), 400]
    blocks = [
        sample_blocks.serialise(begin, voltage_v[begin:end], displacement_um[begin:end])
        for begin, end in zip(bounds, bounds[1:], strict=False)]
    with tempfile.TemporaryDirectory() as directory:
        recording = read_recording(sample_blocks.write(Path(directory, "run"), {TOPIC: blocks}))
    assert np.array_equal(recording.voltage_v, voltage_v)
    assert np.array_equal(recording.displacement_um, displacement_um)
    assert np.array_equal(recording.sample_index, np.arange(400))
    assert recording.gaps == []


def test_gaps_are_found_and_counted(tmp_path, sample_blocks, ten_blocks):
    blocks = [block for k, block in enumerate(ten_blocks[0]) if k not in (3, 6, 7)]
    recording = read_recording(sample_blocks.write(tmp_path / "run", {TOPIC: blocks}))
    assert recording.gaps == [(120, 40), (240, 80)]
    assert recording.sample_index[119:121].tolist() == [119, 160]
    assert len(recording.time_s) == 280
    assert recording.time_s[-1] == pytest.approx(399 * 2.5e-5)


@pytest.mark.parametrize(("order", "beginning"), [((0, 2, 1), 40), ((0, 1, 1), 40)])
def test_backwards_or_overlapping_indices_are_refused(
        tmp_path, sample_blocks, ten_blocks, order, beginning):
    blocks = [ten_blocks[0][k] for k in order]
    path = sample_blocks.write(tmp_path / "run", {TOPIC: blocks})
    with pytest.raises(RecordingError, match=f"block 3 begins at sample {beginning}, before"):
        read_recording(path)


def test_a_slow_waveform_keeps_its_place_on_the_sample_clock(tmp_path, sample_blocks):
    ramp = sample_blocks.serialise(0, np.zeros(40), np.zeros(40), flags=Flag.RAMPING)
    slow = [sample_blocks.serialise(40 + 4000 * k, np.full(10, k), np.full(10, k), 400 / 40000)
            for k in range(3)]
    path = sample_blocks.write(tmp_path / "run", {TOPIC: [ramp, slow[0], slow[2]]})
    recording = read_recording(path)
    assert recording.gaps == [(4040, 4000)]
    with pytest.raises(RecordingError, match="parts with sample periods from 2.5e-05 s to 0.01 s"):
        _ = recording.sample_period_s
    played = recording.select(recording.playing)
    assert played.sample_period_s == pytest.approx(0.01)
    assert played.sample_index.tolist() == [*range(40, 4040, 400), *range(8040, 12040, 400)]
    assert played.time_s[:3] == pytest.approx([0, 0.01, 0.02])
    assert played.gaps == [(4040, 4000)]


def test_the_rate_of_another_sample_clock_is_kept_in_the_file(tmp_path, sample_blocks):
    blocks = [sample_blocks.serialise(40 * k, np.zeros(40), np.zeros(40), 1 / 25600)
              for k in range(3)]
    kept = sample_blocks.write(tmp_path / "kept", {TOPIC: blocks}, sample_rate_hz=25600.0)
    assert read_recording(kept).time_s[-1] == pytest.approx(119 / 25600)
    foreign = sample_blocks.write(tmp_path / "foreign", {TOPIC: blocks})
    with pytest.raises(RecordingError, match="sample_rate_hz="):
        read_recording(foreign)
    assert read_recording(foreign, sample_rate_hz=25600.0).gaps == []


def test_flags_are_those_of_the_message():
    text = MESSAGE_FILE.read_text(encoding="utf-8")
    in_message = {name: int(value) for name, value in re.findall(r"FLAG_(\w+)=(\d+)", text)}
    assert in_message == {flag.name: flag.value for flag in Flag}


def test_masks_follow_the_flags_and_leave_ramps_out(tmp_path, sample_blocks):
    flags = [0, Flag.PLAYING, Flag.PLAYING | Flag.RAMPING, Flag.TRACKING | Flag.SLEW_LIMITED]
    blocks = [sample_blocks.serialise(2 * k, [k, k], [0, 0], flags=flag)
              for k, flag in enumerate(flags)]
    recording = read_recording(sample_blocks.write(tmp_path / "run", {TOPIC: blocks}))
    assert np.flatnonzero(recording.playing).tolist() == [2, 3]
    assert np.flatnonzero(recording.tracking).tolist() == [6, 7]
    assert np.flatnonzero(recording.has(Flag.PLAYING)).tolist() == [2, 3, 4, 5]
    assert recording.select(recording.tracking).voltage_v.tolist() == [3, 3]
    with pytest.raises(RecordingError, match="no sample in the part"):
        recording.select(recording.has(Flag.STOPPED))


def test_the_ground_truth_is_read_by_its_topic(tmp_path, sample_blocks):
    path = sample_blocks.write(tmp_path / "run", {
        "/a/stage/samples": [sample_blocks.serialise(0, [1.0], [2.0])],
        "/a/stage/ground_truth": [sample_blocks.serialise(0, [1.0], [2.5])]})
    assert read_recording(path).displacement_um == [2.0]
    for topic in ("ground_truth", "stage/ground_truth", "/a/stage/ground_truth"):
        assert read_recording(path, topic=topic).displacement_um == [2.5]


def test_several_stages_are_listed_and_one_is_chosen(tmp_path, sample_blocks):
    path = sample_blocks.write(tmp_path / "run", {
        f"/{name}/stage/samples": [sample_blocks.serialise(0, [value], [value])]
        for name, value in (("x", 1.0), ("y", 2.0))})
    with pytest.raises(RecordingError, match="/x/stage/samples, /y/stage/samples: choose one"):
        read_recording(path)
    assert read_recording(path, topic="/y/stage/samples").voltage_v == [2.0]
    with pytest.raises(RecordingError, match="no topic of samples 'z/samples'"):
        read_recording(path, topic="z/samples")


def test_the_hash_is_that_of_the_data_file(tmp_path, sample_blocks, ten_blocks):
    path = sample_blocks.write(tmp_path / "run", {TOPIC: ten_blocks[0]})
    expected = hashlib.sha256((path / "run_0.mcap").read_bytes()).hexdigest()
    assert sha256_of(path) == sha256_of(path / "run_0.mcap") == expected


@pytest.mark.parametrize(("prepare", "message"), [
    (lambda path: None, "does not exist"),
    (lambda path: path.mkdir(), "no readable metadata.yaml"),
    (lambda path: path.write_bytes(b"nonsense, long enough for a header"),
     "no table of numbers"),
    (lambda path: path.write_bytes(b""), "no table of numbers"),
    (lambda path: RecordingWriter(path).close(), "has no topic of samples"),
])
def test_what_is_no_recording_is_refused(tmp_path, prepare, message):
    prepare(tmp_path / "run")
    with pytest.raises(RecordingError, match=message) as caught:
        read_recording(tmp_path / "run")
    assert "\n" not in str(caught.value)


def test_a_topic_without_samples_is_refused(tmp_path, sample_blocks):
    path = sample_blocks.write(tmp_path / "run", {TOPIC: [], "/stage/ground_truth": []})
    with pytest.raises(RecordingError, match="holds no samples on /stage/samples"):
        read_recording(path)


def test_voltages_and_displacements_of_unequal_number_are_refused(tmp_path, sample_blocks):
    path = sample_blocks.write(
        tmp_path / "run", {TOPIC: [sample_blocks.serialise(0, [1.0, 2.0], [1.0])]})
    with pytest.raises(RecordingError, match="block 1 has not as many voltages"):
        read_recording(path)
