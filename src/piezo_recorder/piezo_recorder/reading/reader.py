# SPDX-License-Identifier: BSD-3-Clause
"""Reader of recordings: rosbag2 directories, MCAP files and the files of other programs."""

import hashlib
import shlex
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO

import mcap.records
import numpy as np
import yaml
from mcap.stream_reader import StreamReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from piezo_common.cancellation import check_cancelled
from piezo_common.regular_file import UnreadableFile, open_regular
from piezo_common.text_file import read_bounded_text
from piezo_recorder import sample_block
from piezo_recorder.reading.columns import GUESSED, ColumnsDocument
from piezo_recorder.reading.detected import columns_of_blocks
from piezo_recorder.reading.recording import Recording, RecordingError
from piezo_recorder.reading.table_reader import read_table_recordings
from piezo_recorder.reading.tables.table import Progress, no_progress
from piezo_recorder.reading.tracked_reference import TYPE_NAME as REFERENCE_TYPE
from piezo_recorder.reading.tracked_reference import reference_of
from piezo_recorder.writing.writer import STAGE_METADATA

GROUND_TRUTH = "ground_truth"
# An hour at 40 kHz takes about 5 GB.
LARGEST_BYTES = 16_000_000_000
MCAP_MAGIC = b"\x89MCAP0\r\n"
NO_KIND = 0
"""A record type that does not exist in MCAP files."""
PART_BYTES = 1 << 20
METADATA = "metadata.yaml"
MOST_NAMED = 20
"""Largest number of a folder's files that a message names."""


def read_recording(path: str | PathLike[str], topic: str | None = None,
                   sample_rate_hz: float | None = None, columns: ColumnsDocument = GUESSED,
                   progress: Progress = no_progress, several_axes: bool = False) -> Recording:
    """Read a recording: a rosbag2 directory, an MCAP file, or a file of another program.

    Parameters
    ----------
    path : str or Path
        The kind is recognised by being a directory, by the extension ``.mcap``, or by its first
        bytes: text of any delimiter, .mat, HDF5, .npz, .npy, TDMS, Parquet, Arrow.
    topic : str, optional
        Topic of the sample blocks, or its last part such as ``ground_truth``. The default is the
        only topic that is not the ground truth.
    sample_rate_hz : float, optional
        Rate of the sample clock, for recordings of this suite that do not contain it; 40 kHz by
        default.
    columns : ColumnsDocument
        Description of the columns of another program's file, e.g. from `parse_columns`; a YAML
        file next to the data may add to it, and the rest is guessed.
    progress : callable
        Called with the name of the present step and the fraction done (0 to 1).
    several_axes : bool
        Whether a recording of a stage of several axes is accepted, too.

    Returns
    -------
    Recording
        Its ``notes`` describe what was assumed, corrected or found implausible.

    Raises
    ------
    RecordingError
        If the file is missing, damaged or ambiguous, has no samples, or several recordings.

    Examples
    --------
    >>> import numpy as np
    >>> time_s = 1e-3 * np.arange(500)
    >>> voltage_v = 5.0 - 5.0 * np.cos(20.0 * time_s)
    >>> np.savetxt("mine.csv", np.column_stack([time_s, voltage_v, 2e3 * voltage_v]),
    ...            delimiter=",", comments="", header="t [s],U [V],y [nm]")
    >>> read_recording("mine.csv")
    <Recording mine.csv: 500 samples every 0.001 s, 0 to 10 V, 0 to 20 um>
    """
    return only_recording(
        path, read_recordings(path, topic, sample_rate_hz, columns, progress, several_axes))


def only_recording(path: str | PathLike[str], found: list[Recording]) -> Recording:
    """Return the single recording of a file; raise RecordingError if it has several."""
    if len(found) > 1:
        titles = ", ".join(each.title for each in found[:12])
        raise RecordingError(
            f"{path} holds {len(found)} recordings ({titles}): choose one, as in --columns "
            f"recording=[{found[0].title}]")
    return found[0]


def read_recordings(path: str | PathLike[str], topic: str | None = None,
                    sample_rate_hz: float | None = None, columns: ColumnsDocument = GUESSED,
                    progress: Progress = no_progress,
                    several_axes: bool = False) -> list[Recording]:
    """Read all recordings of a file; those of other programs may have several.

    They are distinguished by a column that numbers them, by groups of the file, by a repeated
    header, or by a time that starts again. See `read_recording`.

    Examples
    --------
    >>> import numpy as np
    >>> time_s = 1e-3 * np.tile(np.arange(250), 2)           # begins anew
    >>> voltage_v = 5.0 - 5.0 * np.cos(20.0 * time_s)
    >>> np.savetxt("two.csv", np.column_stack([time_s, voltage_v, 2.0 * voltage_v]),
    ...            delimiter=",", comments="", header="time_s,voltage_v,displacement_um")
    >>> [each.voltage_v.size for each in read_recordings("two.csv")]
    [250, 250]
    """
    path = Path(path)
    if not holds_messages(path):
        file, = data_files(path)
        return read_table_recordings(file, columns, progress)
    recording = _read_mcap(path, topic, sample_rate_hz)
    if recording.axes and not several_axes:
        raise RecordingError(
            f"{path} has the axes {', '.join(recording.axes)}, and one axis is wanted: give it to "
            "what takes several, such as check, identify and simulate")
    return [recording]


def holds_messages(path: Path) -> bool:
    """Return whether a path is a recording of this suite (MCAP file or its folder)."""
    if path.is_dir() or path.suffix.lower() == ".mcap":
        return True
    file, = data_files(path)
    with open(file, "rb") as stream:
        return stream.read(len(MCAP_MAGIC)) == MCAP_MAGIC


def axes_of_messages(path: Path) -> tuple[str, ...]:
    """Return the names of the axes of a recording of this suite; empty for a single axis.

    RecordingError is raised if there is no such file.
    """
    contents = _Contents()
    for file in data_files(path):
        contents.read(file, until=contents.has_samples)
    for blocks in contents.blocks.values():
        if blocks and contents.schema is not None:
            return _axes_of(_decode(path, contents.schema, blocks[:1], "sample block")[0])
    return ()


def sha256_of(path: str | PathLike[str]) -> str:
    """Return the SHA-256 hash (hexadecimal) of a recording's data, i.e. its MCAP or CSV file.

    Examples
    --------
    >>> from pathlib import Path
    >>> _ = Path("empty.csv").write_text("")
    >>> sha256_of("empty.csv")[:16]
    'e3b0c44298fc1c14'
    """
    digest = hashlib.sha256()
    for file in data_files(Path(path)):
        with open(file, "rb") as stream:
            while part := stream.read(PART_BYTES):
                check_cancelled()
                digest.update(part)
    return digest.hexdigest()


def origin_of(data: Any) -> dict[str, str]:
    """Return the entries of a model file that identify the data: `path` and `sha256`."""
    path = getattr(data, "path", data)
    return {"path": str(path), "sha256": getattr(data, "sha256", "") or sha256_of(path)}


def data_files(path: Path) -> list[Path]:
    """Return the files that contain a recording's data; raise RecordingError if there are none."""
    if not path.exists():
        raise RecordingError(f"{path} does not exist: give a recording's directory, an MCAP file, "
                             "or a table of samples.")
    if not path.is_dir():
        return [_bounded(path)]
    try:
        text = read_bounded_text(path / METADATA)
        metadata = yaml.safe_load(text)["rosbag2_bagfile_information"]
        storage = metadata["storage_identifier"]
        compression = metadata["compression_mode"].lower()
        names = [Path(name) for name in metadata["relative_file_paths"]]
    except (UnreadableFile, yaml.YAMLError, KeyError, TypeError, AttributeError):
        inside = sorted(shlex.quote(str(each)) for each in path.iterdir()
                        if each.is_file() and each.name != METADATA)
        remedy = (f"give a file in it, {' '.join(inside[:MOST_NAMED])}"
                  f"{' ...' if len(inside) > MOST_NAMED else ''}" if inside else
                  "it holds no other file; give a recording or a table")
        raise RecordingError(f"{path} has no readable metadata.yaml, so it is no recording: "
                             f"{remedy}") from None
    if storage != "mcap" or compression not in ("", "none"):
        raise RecordingError(
            f"{path} is stored as {storage} {compression}: "
            "convert it with `ros2 bag convert` to uncompressed mcap.")
    for name in names:
        if name.parts != (name.name,):
            raise RecordingError(f"{path} names {name}, which is not in it: move it there, and "
                                 "mend metadata.yaml.")
        if not (path / name).exists():
            raise RecordingError(f"{path} names {name}, which is missing: copy it there.")
    return [_bounded(path / name) for name in names]


def _bounded(file: Path) -> Path:
    try:
        open_regular(file, LARGEST_BYTES).close()
    except UnreadableFile as error:
        raise RecordingError(f"{file} {error}: give a recording, or cut it into parts.") from None
    except OSError as error:
        raise RecordingError(f"{file} cannot be read ({error.strerror}): "
                             "give a file that may be read.") from None
    return file


class RecordReader(StreamReader):
    """Reads records until the work is cancelled, or only zeros remain in the file.

    A power failure can leave zeros. Read as records without type and length, they would be skipped
    one by one.
    """

    def _read_record(self, opcode: int, length: int) -> mcap.records.McapRecord | None:
        check_cancelled()
        while opcode == NO_KIND:
            if self._stream.read(PART_BYTES).strip(b"\0"):
                raise ValueError("a record of no kind")
            check_cancelled()
        record: mcap.records.McapRecord | None = super()._read_record(opcode, length)
        return record


class _Contents:
    """Serialised sample blocks, references and attachments of one or more MCAP files."""

    def __init__(self) -> None:
        self.topics: dict[str, str] = {}
        self.blocks: dict[str, list[bytes]] = {}
        self.schema: mcap.records.Schema | None = None
        self.references: list[bytes] = []
        self.reference_schema: mcap.records.Schema | None = None
        self.attachments: dict[str, bytes] = {}
        self.sample_rate_hz: float | None = None
        self.complete = True

    def has_samples(self) -> bool:
        return any(self.blocks.values())

    def read(self, path: Path, until: Callable[[], bool] = lambda: False) -> None:
        with open(path, "rb") as stream:
            reader = RecordReader(stream, validate_crcs=True)
            schemas: dict[int, mcap.records.Schema] = {}
            channels: dict[int, list[bytes] | None] = {}
            try:
                for record in reader.records:
                    check_cancelled()
                    self._add(record, schemas, channels)
                    if until():
                        return
            # The parser may raise any exception on damaged bytes.
            except Exception as error:
                check_cancelled()  # a cancelled read is not damage
                if not was_cut_short(stream):
                    raise RecordingError(
                        f"{path} is damaged or no MCAP file ({_brief(error)}): "
                        "copy it again or repair the disk.") from None
                self.complete = False

    def _add(self, record: mcap.records.McapRecord, schemas: dict[int, mcap.records.Schema],
             channels: dict[int, list[bytes] | None]) -> None:
        if isinstance(record, mcap.records.Message):
            blocks = channels[record.channel_id]
            if blocks is not None:
                blocks.append(record.data)
        elif isinstance(record, mcap.records.Schema):
            schemas[record.id] = record
        elif isinstance(record, mcap.records.Channel):
            schema = schemas[record.schema_id]
            self.topics[record.topic] = schema.name
            is_samples = schema.name == sample_block.TYPE_NAME
            if is_samples:
                self.schema = schema
            channels[record.id] = self.blocks.setdefault(record.topic, []) if is_samples else None
            if schema.name == REFERENCE_TYPE:
                self.reference_schema, channels[record.id] = schema, self.references
        elif isinstance(record, mcap.records.Attachment):
            self.attachments[record.name] = record.data
        elif isinstance(record, mcap.records.Metadata) and record.name == STAGE_METADATA:
            self.sample_rate_hz = float(record.metadata["sample_rate_hz"])


def _brief(error: Exception) -> str:
    """Shorten the message of a library to one line."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def was_cut_short(stream: BinaryIO) -> bool:
    """Return whether a file was left by a killed recorder and read to its end, not damaged."""
    read_to_end = not stream.read(1)
    stream.seek(0)
    starts_well = stream.read(len(MCAP_MAGIC)) == MCAP_MAGIC
    stream.seek(-min(stream.seek(0, 2), len(MCAP_MAGIC)), 2)
    was_closed = stream.read() == MCAP_MAGIC and stream.tell() > len(MCAP_MAGIC)
    return read_to_end and starts_well and not was_closed


def _read_mcap(path: Path, topic: str | None, sample_rate_hz: float | None) -> Recording:
    contents = _Contents()
    for file in data_files(path):
        contents.read(file)
    topic = _choose_topic(path, contents, topic)
    assert contents.schema is not None  # it came with the topic
    blocks = _decode_blocks(path, contents.schema, contents.blocks[topic])
    rate_hz = sample_rate_hz or contents.sample_rate_hz or sample_block.DEFAULT_SAMPLE_RATE_HZ
    return _join(path, topic, blocks, rate_hz, contents)


def _choose_topic(path: Path, contents: _Contents, topic: str | None) -> str:
    names = sorted(contents.blocks)
    if topic is None:
        fitting = [name for name in names if not name.endswith("/" + GROUND_TRUTH)]
    else:
        fitting = [name for name in names if ("/" + name).endswith("/" + topic)]
    if len(fitting) > 1:
        raise RecordingError(
            f"{path} has several topics of samples, {', '.join(fitting)}: "
            "choose one with topic=.")
    if not fitting:
        wanted = f"topic of samples '{topic}'" if topic else "topic of samples"
        found = ", ".join(sorted(contents.topics)) or "none"
        raise RecordingError(
            f"{path} has no {wanted} (topics: {found}): "
            f"record one of type {sample_block.TYPE_NAME}, or choose another with topic=.")
    if not contents.blocks[fitting[0]]:
        raise RecordingError(f"{path} holds no samples on {fitting[0]}: record while a stage runs.")
    return fitting[0]


def _decode(path: Path, schema: mcap.records.Schema, messages: list[bytes],
            name: str) -> list[Any]:
    typestore = get_typestore(Stores.EMPTY)
    try:
        typestore.register(get_types_from_msg(schema.data.decode(), schema.name))
        return [typestore.deserialize_cdr(data, schema.name) for data in messages]
    except Exception as error:
        raise RecordingError(
            f"{path} has a {name} that does not fit its own definition ({_brief(error)}): "
            "record it again.") from None


def _reference(path: Path, contents: _Contents, sample_index: np.ndarray) -> np.ndarray:
    if contents.reference_schema is None:
        return np.empty(0)
    return reference_of(_decode(path, contents.reference_schema, contents.references, "reference"),
                        sample_index)


def _decode_blocks(path: Path, schema: mcap.records.Schema, blocks: list[bytes]) -> list[Any]:
    decoded = _decode(path, schema, blocks, "sample block")
    uneven = next((number for number, block in enumerate(decoded, start=1)
                   if len(block.voltage_v) != len(block.displacement_um)), None)
    if uneven:
        raise RecordingError(
            f"{path}: sample block {uneven} has not as many voltages as displacements: "
            "mend the stage that published it.")
    return decoded


def _join(path: Path, topic: str, blocks: list[Any], sample_rate_hz: float,
          contents: _Contents) -> Recording:
    axes = _axes_of(blocks[0])
    if any(_axes_of(block) != axes for block in blocks):
        raise RecordingError(f"{path}: on {topic} the names of the axes change: "
                             "record one stage at a time")
    shape = (-1, len(axes)) if axes else (-1,)
    counts = np.array([len(block.voltage_v) // max(1, len(axes)) for block in blocks])
    first = np.array([block.first_sample for block in blocks], dtype=np.int64)
    periods_s = np.array([block.sample_period_s for block in blocks])
    strides = _strides(path, periods_s, sample_rate_hz)
    ends = first + counts * strides
    within_block = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    sample_index = np.repeat(first, counts) + within_block * np.repeat(strides, counts)
    return Recording(
        path=str(path),
        sample_rate_hz=sample_rate_hz,
        sample_index=sample_index,
        reference_um=_reference(path, contents, sample_index),
        sample_periods_s=np.repeat(strides / sample_rate_hz, counts),
        voltage_v=np.concatenate([block.voltage_v for block in blocks]).reshape(shape),
        displacement_um=np.concatenate([block.displacement_um for block in blocks]).reshape(shape),
        flags=np.repeat(np.array([block.flags for block in blocks], dtype=np.uint32), counts),
        gaps=_gaps(path, topic, first, ends),
        attachments=contents.attachments,
        columns=columns_of_blocks(blocks, counts),
        complete=contents.complete,
        axes=axes)


def _axes_of(block: Any) -> tuple[str, ...]:
    """Return the names of the axes of a block; older blocks have none."""
    return tuple(getattr(block, "axes", ()))


def _strides(path: Path, periods_s: np.ndarray, sample_rate_hz: float) -> np.ndarray:
    """Return, for every block, the number of clock samples between two of its samples."""
    exact = periods_s * sample_rate_hz
    if not np.all(np.isfinite(exact)) or np.any(exact < 0.5):
        strides = np.zeros(len(exact), dtype=np.int64)
    else:
        strides = np.round(exact).astype(np.int64)
    wrong = np.flatnonzero(~(np.abs(exact - strides) <= 1e-6 * np.abs(exact)))
    if len(wrong):
        raise RecordingError(
            f"{path}: sample block {wrong[0] + 1} has a sample period of "
            f"{periods_s[wrong[0]]:g} s, no multiple of the sample clock's "
            f"{1 / sample_rate_hz:g} s: give the stage's sample_rate_hz=.")
    return strides


def _gaps(path: Path, topic: str, first: np.ndarray, ends: np.ndarray) -> list[tuple[int, int]]:
    overlapping = np.flatnonzero(first[1:] < ends[:-1])
    if len(overlapping):
        block = overlapping[0]
        raise RecordingError(
            f"{path}: on {topic} sample block {block + 2} begins at sample {first[block + 1]}, "
            f"before the end {ends[block]} of the one before it: record one stage at a time, "
            "from one activation on, or give the stage's sample_rate_hz=.")
    missing = first[1:] - ends[:-1]
    return [(int(ends[block]), int(missing[block])) for block in np.flatnonzero(missing)]
