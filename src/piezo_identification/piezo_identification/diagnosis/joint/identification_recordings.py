# SPDX-License-Identifier: BSD-3-Clause
"""The recordings from which a model was identified, found by path and verified by hash."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from piezo_identification.conditioning.row_alignment import read_as, rows_read_at_start
from piezo_identification.conditioning.segments import played_segments
from piezo_identification.estimators.frequency_response.response_file import is_frequency_response
from piezo_identification.simulation.past_search import conditioned, simulated_recording
from piezo_models.cascade import StageModel
from piezo_models.identified_model import IdentifiedModel
from piezo_recorder.reading.reader import sha256_of
from piezo_recorder.reading.recording import Recording

AnyPath = str | PathLike[str]
ReadFile = Callable[[AnyPath], list[Recording]]

MOST_OLD_SAMPLES = 50_000
"""Number of samples used of each recording of the identification: each costs as much as a new one,
and an effect that biases a model already shows in the first of them."""

NOT_NAMED = "the model file names none"
"""Why no recording is available for a model that was not identified from files."""


@dataclass(frozen=True)
class IdentificationRecordings:
    """Available recordings from which a model was identified."""

    recordings: tuple[Recording, ...] = ()
    """Recordings without gaps, with rows aligned as in the identification."""
    missing: tuple[str, ...] = (NOT_NAMED,)
    """Why others are not available, one sentence without its end for each."""
    hashes: frozenset[str] = frozenset()
    """SHA-256 of all that were fitted; the validation recording was not."""

    @property
    def not_asked(self) -> str:
        """Sentence on what cannot be determined without missing recordings; empty if none is."""
        if not self.missing:
            return ""
        among = "of some of" if self.recordings else "of"
        return ("not tested: which effects the stage already had when the model was identified, "
                f"{among} the recordings that it was identified from ({'; '.join(self.missing)}; "
                "give them with --identified-from FILE...)")

    def document(self) -> dict[str, object]:
        """Return their entry in `verdict.json`."""
        return {"recordings": [str(recording.path) for recording in self.recordings],
                "not_asked": self.not_asked}


def find_identification_recordings(
    identified: IdentifiedModel, model_path: AnyPath, read_file: ReadFile,
    moved: Sequence[AnyPath | Recording] = (), others: Sequence[AnyPath | Recording] = (),
) -> IdentificationRecordings:
    """Find the recordings from which a model was identified, and read those that are unchanged.

    Relative paths are relative to the working directory, or else to the folder of the model.

    Parameters
    ----------
    moved : sequence of path-like or Recording
        Recordings of the identification at their present paths.
    others : sequence of path-like or Recording
        Recordings that are diagnosed or held out, which are excluded.

    Raises
    ------
    ValueError
        If a file in `moved` does not belong to the identification, or cannot be read.
    """
    hashes = {entry["sha256"]: entry["path"] for entry in identified.recordings}
    given = {digest_of(each) or f"no file {number}": each for number, each in enumerate(moved)}
    for digest, each in given.items():
        if hashes and digest not in hashes and not isinstance(each, Recording):
            raise ValueError(
                f"{each} is none of the recordings that {model_path} was identified from: its "
                "SHA-256 is not in the model file; leave it out, or give the unchanged file")
    left_out = set(map(digest_of, others))
    found: list[Recording] = []
    missing: list[str] = []
    names = _names(identified)
    for digest, named in (hashes | dict.fromkeys(given.keys() - hashes.keys(), "")).items():
        if digest in left_out:
            continue
        source, why_not = (given[digest], "") if digest in given else _unchanged(
            named, digest, Path(model_path))
        if not why_not:
            try:
                read, why_not = _read(source, read_file)
                found += _usable(read, identified.rows.get(names.get(digest, ""), {}))
            except (ValueError, OSError) as error:
                if digest in given:
                    raise
                why_not = str(error).rstrip(".")
        missing += [why_not] if why_not else []
    if not hashes and not given:
        missing.append(NOT_NAMED)
    fitted = fitted_hashes(identified) if hashes else frozenset(given)
    return IdentificationRecordings(tuple(found), tuple(missing), fitted)


def digest_of(source: AnyPath | Recording) -> str:
    """Return the SHA-256 of a recording; empty if it came from no file."""
    if isinstance(source, Recording):
        if source.sha256 or not Path(source.path).exists():
            return source.sha256
        return sha256_of(source.path)
    return sha256_of(source)


def fitted_hashes(identified: IdentifiedModel) -> frozenset[str]:
    """Return the SHA-256 of the recordings to which a model was fitted, without its validation."""
    names = _names(identified)
    return frozenset(entry["sha256"] for entry in identified.recordings
                     if names.get(entry["sha256"]) != "validation")


def old_recordings(model: StageModel, known: IdentificationRecordings) -> list[Recording]:
    """Return the recordings of the identification, conditioned like the new ones.

    Those that are too short are omitted. Only the beginning of long ones is used, because a
    simulation has to start there.
    """
    usable = []
    for recording in known.recordings:
        early = np.cumsum(recording.playing | recording.tracking) <= MOST_OLD_SAMPLES
        try:
            signed, _ = conditioned(model, recording.select(early))
            simulated_recording(model, signed, ())
        except ValueError:
            continue
        usable.append(signed)
    return usable


def _names(identified: IdentifiedModel) -> Mapping[str, str]:
    """Return the experiment of each recording by its hash, if every file is one experiment."""
    names = [*identified.sample_periods_s, "validation"]
    digests = [entry["sha256"] for entry in identified.recordings]
    return dict(zip(digests, names, strict=False)) if len(digests) in (
        len(names), len(names) - 1) else {}


def _unchanged(named: str, digest: str, model_path: Path) -> tuple[Path, str]:
    """Return the path of a recording, and why it is not the original one, if so."""
    path = Path(named)
    if not path.exists() and not path.is_absolute():
        path = model_path.parent / path
    if not path.exists():
        return path, f"{named} is not there"
    return path, "" if sha256_of(path) == digest else f"{named} has changed since"


def _read(source: AnyPath | Recording, read_file: ReadFile) -> tuple[list[Recording], str]:
    """Return the recordings of a source, and why there are none, if so."""
    if isinstance(source, Recording):
        return [source], ""
    if is_frequency_response(Path(source)):
        return [], f"{source} is a frequency response"
    return read_file(source), ""


def _usable(recordings: Iterable[Recording], rows: Mapping[str, float]) -> list[Recording]:
    """Cut recordings at their gaps, with their rows aligned as the identification did."""
    read_at = rows.get("read_at_samples", 0.0)
    return [
        rows_read_at_start(part, read_as(part, read_at))
        for recording in recordings
        for part in (played_segments(recording) if recording.gaps else [recording])]
