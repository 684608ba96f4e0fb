# SPDX-License-Identifier: BSD-3-Clause
"""Whatever is in a file, it is read right or refused in one sentence: mutated real files."""

import os
import re
import signal
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from piezo_controller.feedback.controller_file import load_controller, save_controller
from piezo_controller.feedback.feedback_design import FeedbackController
from piezo_controller.feedback.synthesis.weights import BUILT_IN, load_weights
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.model_file import load_model, save_model
from piezo_recorder.reading.reader import read_recording
from piezo_recorder.sample_block import TYPE_NAME
from piezo_recorder.writing.message_definition import installed_definition
from piezo_recorder.writing.writer import RecordingWriter
from piezo_stage_driver.backends.calibration import load_calibration

INPUTS = 10_000 if os.environ.get("LONG_TESTS") else 500
LONGEST_SENTENCE = 1000
HANG_S = 60
SOURCE = Path(__file__).parents[1] / "src"


def write_model(path):
    density = np.tril(np.random.default_rng(1).uniform(1e-3, 2e-2, (6, 6)))
    save_model(path, IdentifiedModel(
        StageModel(PreisachModel(-20.0, 120.0, density, -9.0),
                   CreepDynamics((0.1, 1.0), (0.11, 1.1)),
                   ElectricVibrationDynamics(5e-4, (2846.0,), (0.68,))),
        (-20.0, 120.0), {"creep": 0.01}, {"e_y_percent": 0.1},
        [{"path": "creep", "sha256": "ab" * 32}]))


def write_controller(path):
    save_controller(path, FeedbackController(
        np.diag([0.5, 0.9]), np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1)), 1e-3,
        {"mu": 0.9}, {}, "0" * 64))


def write_csv(path):
    rows = [f"{n * 25e-6:.6f},{n % 7},{n % 5 * 0.1:.3f}" for n in range(60)]
    path.write_text("\n".join(["time_s,voltage_v,displacement_um", *rows]) + "\n")


def write_mcap(path):
    typestore = get_typestore(Stores.ROS2_JAZZY)
    text = (SOURCE / "piezo_interfaces" / "msg" / "SampleBlock.msg").read_text()
    typestore.register(get_types_from_msg(text, TYPE_NAME))
    types = typestore.types
    with RecordingWriter(path.with_suffix(""), 40_000.0) as writer:
        writer.attach("model.json", b"{}")
        channel = writer.add_topic("/stage/samples", installed_definition(TYPE_NAME))
        for tick in range(6):
            header = types["std_msgs/msg/Header"](
                types["builtin_interfaces/msg/Time"](0, 0), "stage")
            block = types[TYPE_NAME](
                header=header, first_sample=40 * tick, sample_period_s=25e-6, tick=tick + 1,
                voltage_v=np.full(40, float(tick)), displacement_um=np.arange(40.0), flags=16,
                missed_feedback=0, axes=[], marks=np.empty(0, np.uint8),
                signals=[], signal=np.empty(0))
            writer.write(channel, bytes(typestore.serialize_cdr(block, TYPE_NAME)), tick)
    folder = path.with_suffix("")
    path.write_bytes((folder / f"{folder.name}_0.mcap").read_bytes())


def is_a_model(identified):
    displacement_um = identified.model.simulate(np.linspace(-20.0, 100.0, 50), 1e-3)
    assert displacement_um.shape == (50,)


def is_a_controller(controller):
    assert np.isfinite(controller.A).all() and controller.sample_period_s > 0.0


def is_a_recording(recording):
    lengths = {len(getattr(recording, name)) for name in (
        "sample_index", "sample_periods_s", "voltage_v", "displacement_um", "flags")}
    assert lengths == {len(recording.voltage_v)}
    assert np.all(np.diff(recording.sample_index) > 0)


KINDS = {
    "model.json": (write_model, load_model, is_a_model),
    "controller.json": (write_controller, load_controller, is_a_controller),
    "data.csv": (write_csv, read_recording, is_a_recording),
    "data.mcap": (write_mcap, read_recording, is_a_recording),
    "weights.yaml": (lambda path: path.write_text(BUILT_IN["default"].read_text()),
                     load_weights, lambda weights: weights.at_tick(1e-3)),
    "calibration.yaml": (
        lambda path: path.write_bytes(
            (SOURCE / "piezo_stage_driver/config/nidaqmx_calibration.yaml").read_bytes()),
        load_calibration, lambda calibration: calibration.card_v(1.0)),
}
TOKENS = [b"NaN", b"-Infinity", b"1e999", b"-1", b"0", b"1e-320", b"99999999999999999999999",
          b"null", b"true", b'""', b"[]", b"{}", b"[[[[[[[[", b"\x00", b"\xff\xfe", b"\xef\xbb\xbf",
          "Â½µ".encode(), b",", b"\n", b"&a [*a, *a]", b"!!python/object/apply:os.system [id]",
          b"__import__('os')"]


def mutated(content, random):
    """Change real content as accidents and malice do."""
    content = bytearray(content)
    for _ in range(random.integers(1, 4)):
        at = int(random.integers(0, len(content) + 1))
        end = min(len(content), at + int(random.integers(1, 60)))
        numbers = [match.span() for match in re.finditer(rb"-?\d+\.?\d*(e-?\d+)?", content)]
        match random.integers(0, 7):
            case 0:
                content[at:at + 1] = random.bytes(1)
            case 1:
                del content[at:end]
            case 2:
                content[at:at] = content[at:end] * int(random.integers(1, 4))
            case 3:
                del content[at:]
            case 4:
                content[at:at] = TOKENS[random.integers(len(TOKENS))]
            case 5 if numbers:
                first, last = numbers[random.integers(len(numbers))]
                content[first:last] = TOKENS[random.integers(len(TOKENS))]
            case 6:
                lines = bytes(content).split(b"\n")
                random.shuffle(lines)
                content = bytearray(b"\n".join(lines))
    return bytes(content)


@contextmanager
def no_hang():
    def fail(*_):
        raise TimeoutError(f"an input took more than {HANG_S} s")

    before = signal.signal(signal.SIGALRM, fail)
    signal.alarm(HANG_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def assert_read_or_refused(path, read, holds):
    with no_hang():
        try:
            result = read(path)
        except ValueError as error:
            sentence = str(error)
            assert type(error) is not ValueError, sentence  # of the suite, not of a library
            assert path.name in sentence
            assert "\n" not in sentence
            assert len(sentence) < LONGEST_SENTENCE
            return False
        holds(result)
    return True


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", KINDS)
def test_mutated_file_is_read_or_refused_in_one_sentence(tmp_path, name):
    write, read, holds = KINDS[name]
    path = tmp_path / name
    write(path)
    content = path.read_bytes()
    assert assert_read_or_refused(path, read, holds)
    refused = 0
    for seed in range(INPUTS // len(KINDS) + 1):
        path.write_bytes(mutated(content, np.random.default_rng(seed)))
        try:
            refused += not assert_read_or_refused(path, read, holds)
        except Exception as error:
            error.add_note(f"input {seed} of {name}: {path.read_bytes()[:2000]!r}")
            raise
    assert refused > INPUTS // len(KINDS) // 10


@settings(deadline=None, max_examples=INPUTS // 10)
@given(content=st.binary(max_size=300) | st.text(max_size=300).map(str.encode),
       name=st.sampled_from(sorted(KINDS)))
def test_arbitrary_content_is_refused(tmp_path_factory, content, name):
    path = tmp_path_factory.getbasetemp() / name
    path.write_bytes(content)
    _, read, holds = KINDS[name]
    assert_read_or_refused(path, read, holds)


@pytest.mark.parametrize("name", [name for name in KINDS if name.endswith(".yaml")])
def test_document_that_grows_when_it_is_read_is_refused(tmp_path, name):
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 12)]
    path = tmp_path / name
    _, read, holds = KINDS[name]
    path.write_text("\n".join(lines))
    assert not assert_read_or_refused(path, read, holds)
    # The same as the value of an entry that is known.
    key = "amplifier_gain" if name.startswith("cal") else "tick_s"
    path.write_text("\n".join([*lines, f"{key}: *a11"]))
    assert not assert_read_or_refused(path, read, holds)


@pytest.mark.parametrize("name", KINDS)
def test_file_larger_than_any_sensible_one_is_refused_unread(tmp_path, name):
    path = tmp_path / name
    with open(path, "wb") as file:
        file.truncate(1 << 36)
    _, read, holds = KINDS[name]
    assert not assert_read_or_refused(path, read, holds)


@pytest.mark.parametrize("write", [write_model, write_controller])
@pytest.mark.parametrize("name", ["data.csv", "data.mcap", "model.json", "controller.json"])
def test_output_never_overwrites_what_is_something_else(tmp_path, write, name):
    path = tmp_path / name
    KINDS[name][0](path)
    before = path.read_bytes()
    if KINDS[name][0] is write:
        write(path)
        return
    with pytest.raises(ValueError, match="is there already and is no .* choose another name"):
        write(path)
    assert path.read_bytes() == before


def test_nothing_is_parsed_by_pickle_or_eval():
    forbidden = re.compile(r"\b(pickle|marshal|shelve)\b|\b(eval|exec)\(|yaml\.(load|unsafe)|"
                           r"allow_pickle")
    files = [path for path in SOURCE.glob("*/piezo_*/**/*.py")]
    assert len(files) > 100
    assert [path for path in files if forbidden.search(path.read_text())] == []
