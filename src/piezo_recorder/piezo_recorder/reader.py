# SPDX-License-Identifier: BSD-3-Clause
"""Reader of recordings: rosbag2 directories, MCAP files and CSV files."""

import csv
import hashlib
import math
import warnings
from dataclasses import dataclass, field, replace
from pathlib import Path

import mcap.records
import numpy as np
import yaml
from mcap.stream_reader import StreamReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from piezo_recorder import sample_block
from piezo_recorder.sample_block import Flag
from piezo_recorder.writer import STAGE_METADATA

GROUND_TRUTH = "ground_truth"
CSV_COLUMNS = ("time_s", "voltage_v", "displacement_um")
# Of a period: what rounding of the times in a CSV file may come to.
CSV_TIME_TOLERANCE = 0.1
# An hour at 40 kHz takes about 5 GB.
LARGEST_BYTES = 16_000_000_000
MCAP_MAGIC = b"\x89MCAP0\r\n"


class RecordingError(ValueError):
    """A recording cannot be read; the message tells where and what to do."""


@dataclass(frozen=True)
class Recording:
    """Samples of a stage in the order of the sample clock.

    Attributes
    ----------
    path : str
        Where it was read.
    sample_rate_hz : float
        Rate of the sample clock.
    sample_index : ndarray, shape (N,), int64
        Index of each sample on the sample clock.
    sample_periods_s : ndarray, shape (N,)
        Distance to the next sample; longer than the clock's where a slow waveform plays.
    voltage_v : ndarray, shape (N,)
        Applied from the sample on.
    displacement_um : ndarray, shape (N,)
        Measured before the voltage acts.
    flags : ndarray, shape (N,), uint32
        `Flag` bits. A CSV file counts as a waveform that plays throughout.
    gaps : list of (int, int)
        First missing index of the sample clock, and how many are missing.
    attachments : dict of str to bytes
        Files kept in the recording.
    columns : dict of str to ndarray, shape (N,)
        Further columns of a CSV file.
    complete : bool
        False where the recorder was killed before it closed the file.
    """

    path: str
    sample_rate_hz: float
    sample_index: np.ndarray
    sample_periods_s: np.ndarray
    voltage_v: np.ndarray
    displacement_um: np.ndarray
    flags: np.ndarray
    gaps: list = field(default_factory=list)
    attachments: dict = field(default_factory=dict)
    columns: dict = field(default_factory=dict)
    complete: bool = True

    @property
    def time_s(self):
        """Time since the first sample, shape (N,)."""
        return (self.sample_index - self.sample_index[0]) / self.sample_rate_hz

    @property
    def sample_period_s(self):
        """The one sample period; RecordingError where parts differ."""
        periods_s = np.unique(self.sample_periods_s)
        if len(periods_s) > 1:
            raise RecordingError(
                f"{self.path} has parts with sample periods from {periods_s[0]:g} s to "
                f"{periods_s[-1]:g} s: select one part, such as select(playing).")
        return float(periods_s[0])

    @property
    def playing(self):
        """Mask of the samples of waveforms proper, without ramps, shape (N,)."""
        return self.has(Flag.PLAYING) & ~self.has(Flag.RAMPING)

    @property
    def tracking(self):
        """Mask of the samples while the feedforward plays, shape (N,)."""
        return self.has(Flag.TRACKING) & ~self.has(Flag.RAMPING)

    def has(self, flag):
        """Return the mask of the samples that have all bits of ``flag``, shape (N,)."""
        return self.flags & np.uint32(flag) == flag

    def select(self, mask):
        """Return the recording reduced to some of its samples.

        Parameters
        ----------
        mask : ndarray of bool, shape (N,)

        Raises
        ------
        RecordingError
            If no sample is left.
        """
        if not np.any(mask):
            raise RecordingError(
                f"{self.path} has no sample in the part asked for: "
                "record while the waveform or the tracking runs.")
        sample_index = self.sample_index[mask]
        return replace(
            self, sample_index=sample_index,
            sample_periods_s=self.sample_periods_s[mask], voltage_v=self.voltage_v[mask],
            displacement_um=self.displacement_um[mask], flags=self.flags[mask],
            columns={name: values[mask] for name, values in self.columns.items()},
            gaps=[gap for gap in self.gaps if sample_index[0] < gap[0] < sample_index[-1]])


def read_recording(path, topic=None, sample_rate_hz=None):
    """Read a rosbag2 directory, an MCAP file or a CSV file.

    Parameters
    ----------
    path : str or Path
        The kind is told by being a directory, or by the ending ``.mcap`` or ``.csv``.
    topic : str, optional
        Topic of the sample blocks, or its last part such as ``ground_truth``. By default the
        only one that is not the ground truth.
    sample_rate_hz : float, optional
        Rate of the sample clock, for files that do not tell it; 40 kHz by default.

    Returns
    -------
    Recording

    Raises
    ------
    RecordingError
        If the file is missing, damaged, ambiguous or holds no samples.
    """
    path = Path(path)
    if path.suffix.lower() == ".csv":
        return _read_csv(path)
    return _read_mcap(path, topic, sample_rate_hz)


def sha256_of(path):
    """Return the SHA-256 hash of a recording's data: of its MCAP or CSV file, hexadecimal."""
    digest = hashlib.sha256()
    for file in data_files(Path(path)):
        with open(file, "rb") as stream:
            while part := stream.read(1 << 20):
                digest.update(part)
    return digest.hexdigest()


def data_files(path):
    """Return the files that hold a recording's data; RecordingError where there are none."""
    if not path.exists():
        raise RecordingError(f"{path} does not exist: give a recording's directory, MCAP or CSV.")
    if not path.is_dir():
        return [_bounded(path)]
    try:
        text = (path / "metadata.yaml").read_text(encoding="utf-8")
        metadata = yaml.safe_load(text)["rosbag2_bagfile_information"]
        storage = metadata["storage_identifier"]
        compression = metadata["compression_mode"].lower()
        files = [path / name for name in metadata["relative_file_paths"]]
    except (OSError, yaml.YAMLError, KeyError, TypeError, AttributeError):
        raise RecordingError(
            f"{path} has no readable metadata.yaml: give the .mcap file inside it.") from None
    if storage != "mcap" or compression not in ("", "none"):
        raise RecordingError(
            f"{path} is stored as {storage} {compression}: "
            "convert it with `ros2 bag convert` to uncompressed mcap.")
    missing = [file for file in files if not file.is_file()]
    if missing:
        raise RecordingError(f"{path} names {missing[0].name}, which is missing: copy it there.")
    return [_bounded(file) for file in files]


def _bounded(file):
    size = file.stat().st_size
    if size > LARGEST_BYTES:
        raise RecordingError(f"{file} has {size} bytes, more than the {LARGEST_BYTES} that are "
                             "read at once: cut it into parts.")
    return file


# --- MCAP ---------------------------------------------------------------------------------------

class _Contents:
    """Sample blocks and side files of one or more MCAP files, undecoded."""

    def __init__(self):
        self.topics = {}
        self.blocks = {}
        self.schema = None
        self.attachments = {}
        self.sample_rate_hz = None
        self.complete = True

    def read(self, path):
        with open(path, "rb") as stream:
            reader = StreamReader(stream, validate_crcs=True)
            schemas, channels = {}, {}
            try:
                for record in reader.records:
                    self._add(record, schemas, channels)
            # Whatever the parser stumbles over in damaged bytes.
            except Exception as error:
                if not was_cut_short(stream):
                    raise RecordingError(
                        f"{path} is damaged or no MCAP file ({_brief(error)}): "
                        "copy it again or repair the disk.") from None
                self.complete = False

    def _add(self, record, schemas, channels):
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
        elif isinstance(record, mcap.records.Attachment):
            self.attachments[record.name] = record.data
        elif isinstance(record, mcap.records.Metadata) and record.name == STAGE_METADATA:
            self.sample_rate_hz = float(record.metadata["sample_rate_hz"])


def _brief(error):
    """What a library says, in one short line."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def was_cut_short(stream):
    """Tell a file that a killed recorder left, read to its end, from a damaged one."""
    read_to_end = not stream.read(1)
    stream.seek(0)
    starts_well = stream.read(len(MCAP_MAGIC)) == MCAP_MAGIC
    stream.seek(-min(stream.seek(0, 2), len(MCAP_MAGIC)), 2)
    was_closed = stream.read() == MCAP_MAGIC and stream.tell() > len(MCAP_MAGIC)
    return read_to_end and starts_well and not was_closed


def _read_mcap(path, topic, sample_rate_hz):
    contents = _Contents()
    for file in data_files(path):
        contents.read(file)
    topic = _choose_topic(path, contents, topic)
    blocks = _decode(path, contents.schema, contents.blocks[topic])
    rate_hz = sample_rate_hz or contents.sample_rate_hz or sample_block.DEFAULT_SAMPLE_RATE_HZ
    return _join(path, topic, blocks, rate_hz, contents)


def _choose_topic(path, contents, topic):
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


def _decode(path, schema, blocks):
    typestore = get_typestore(Stores.EMPTY)
    try:
        typestore.register(get_types_from_msg(schema.data.decode(), schema.name))
        decoded = [typestore.deserialize_cdr(data, schema.name) for data in blocks]
    except Exception as error:
        raise RecordingError(
            f"{path} has a sample block that does not fit its own definition ({_brief(error)}): "
            "record it again.") from None
    uneven = next((number for number, block in enumerate(decoded, start=1)
                   if len(block.voltage_v) != len(block.displacement_um)), None)
    if uneven:
        raise RecordingError(
            f"{path}: sample block {uneven} has not as many voltages as displacements: "
            "mend the stage that published it.")
    return decoded


def _join(path, topic, blocks, sample_rate_hz, contents):
    counts = np.array([len(block.voltage_v) for block in blocks])
    first = np.array([block.first_sample for block in blocks], dtype=np.int64)
    periods_s = np.array([block.sample_period_s for block in blocks])
    strides = _strides(path, periods_s, sample_rate_hz)
    ends = first + counts * strides
    within_block = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return Recording(
        path=str(path),
        sample_rate_hz=sample_rate_hz,
        sample_index=np.repeat(first, counts) + within_block * np.repeat(strides, counts),
        sample_periods_s=np.repeat(strides / sample_rate_hz, counts),
        voltage_v=np.concatenate([block.voltage_v for block in blocks]),
        displacement_um=np.concatenate([block.displacement_um for block in blocks]),
        flags=np.repeat(np.array([block.flags for block in blocks], dtype=np.uint32), counts),
        gaps=_gaps(path, topic, first, ends),
        attachments=contents.attachments,
        complete=contents.complete)


def _strides(path, periods_s, sample_rate_hz):
    """Samples of the clock from one sample of a block to the next, for every block."""
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


def _gaps(path, topic, first, ends):
    overlapping = np.flatnonzero(first[1:] < ends[:-1])
    if len(overlapping):
        block = overlapping[0]
        raise RecordingError(
            f"{path}: on {topic} sample block {block + 2} begins at sample {first[block + 1]}, "
            f"before the end {ends[block]} of the one before it: record one stage at a time, "
            "from one activation on, or give the stage's sample_rate_hz=.")
    missing = first[1:] - ends[:-1]
    return [(int(ends[block]), int(missing[block])) for block in np.flatnonzero(missing)]


# --- CSV ----------------------------------------------------------------------------------------

def _read_csv(path):
    try:
        return _read_table(*data_files(path))
    except (UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(
            f"{path} is not plain text ({error}): save it as comma-separated text.") from None


def _read_table(path):
    header = _csv_header(path)
    values = _csv_values(path, len(header))
    if values is None:
        raise RecordingError(_first_fault(path, header))
    if len(values) < 2:
        raise RecordingError(f"{path} has fewer than two rows of samples: give more of them.")
    columns = dict(zip(header, np.ascontiguousarray(values.T), strict=True))
    period_s = _uniform_period_s(path, columns.pop("time_s"))
    samples = len(values)
    return Recording(
        path=str(path),
        sample_rate_hz=1 / period_s,
        sample_index=np.arange(samples),
        sample_periods_s=np.full(samples, period_s),
        voltage_v=columns.pop("voltage_v"),
        displacement_um=columns.pop("displacement_um"),
        flags=np.full(samples, Flag.PLAYING, dtype=np.uint32),
        columns=columns)


def _csv_header(path):
    with open(path, newline="", encoding="utf-8-sig") as stream:
        header = [name.strip() for name in next(csv.reader(stream), [])]
    for name in CSV_COLUMNS:
        if name not in header:
            raise RecordingError(
                f"{path}, row 1: the column {name} is missing: "
                f"begin the file with the header {','.join(CSV_COLUMNS)}.")
    for name in header:
        if header.count(name) > 1:
            raise RecordingError(
                f"{path}, row 1: the column '{name}' is there twice: rename one of them.")
    return header


def _csv_values(path, columns):
    """Read the table below the header; None unless all its cells are finite numbers."""
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "loadtxt: input contained no data")
            values = np.loadtxt(
                path, delimiter=",", skiprows=1, ndmin=2, comments=None, quotechar='"',
                encoding="utf-8-sig")
    except ValueError:
        return None
    if values.size == 0:
        return values.reshape(0, columns)
    return values if values.shape[1] == columns and np.all(np.isfinite(values)) else None


def _first_fault(path, header):
    """Say which row keeps the file from being a table of finite numbers."""
    with open(path, newline="", encoding="utf-8-sig") as stream:
        rows = csv.reader(stream)
        next(rows)
        for row in rows:
            if row and len(row) != len(header):
                return (f"{path}, row {rows.line_num}: {len(row)} values where the header names "
                        f"{len(header)} columns: complete the row or remove it.")
            for name, cell in zip(header, row, strict=False):
                if not _is_finite(cell):
                    return (f"{path}, row {rows.line_num}: {name} is '{cell}', no finite number: "
                            "mend the value or cut the file there.")
    return f"{path} is no table of numbers: save it as plain comma-separated text."


def _is_finite(cell):
    try:
        return math.isfinite(float(cell))
    except ValueError:
        return False


def _uniform_period_s(path, time_s):
    period_s = (time_s[-1] - time_s[0]) / (len(time_s) - 1)
    deviation_s = time_s - time_s[0] - period_s * np.arange(len(time_s))
    if period_s > 0 and np.all(np.abs(deviation_s) <= CSV_TIME_TOLERANCE * period_s):
        return period_s
    steps_s = np.diff(time_s)
    usual_s = np.median(steps_s)
    worst = int(np.argmax(np.abs(steps_s - usual_s)))
    raise RecordingError(
        f"{path}, row {worst + 3}: time_s steps by {steps_s[worst]:g} s where {usual_s:g} s is "
        "usual: resample the data to one sample period.")
