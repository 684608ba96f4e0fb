# SPDX-License-Identifier: BSD-3-Clause
"""What was learned of a reference: one versioned JSON document."""

import dataclasses
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piezo_common.text_file import replace_text

FORMAT = "piezo_learned_feedforward"
VERSION = 1


class LearnedFileError(ValueError):
    """A file of a learned feedforward that cannot be used: says path and cure."""


@dataclass(frozen=True, eq=False)
class Learned:
    """A correction, and what it was learned for.

    Attributes
    ----------
    reference : Reference
    model_sha256 : str
    sample_rate_hz : float
    correction_um : (P,) array
        One period of what is added to the reference before it is inverted.
    error_rms_um : float
        Of the harmonics that were learned, at its best.
    iterations : int
    """

    reference: object
    model_sha256: str
    sample_rate_hz: float
    correction_um: np.ndarray
    error_rms_um: float
    iterations: int


def learned_path(directory, reference, model_sha256):
    """Where a directory keeps what was learned of a reference with a model."""
    key = json.dumps([_plain(reference), model_sha256], sort_keys=True)
    return Path(directory) / f"learned_{hashlib.sha256(key.encode()).hexdigest()[:16]}.json"


def save_learned(path, learned):
    """Write the file at once, in place of one that is there."""
    path = Path(path)
    document = {
        "format": FORMAT, "version": VERSION, "reference": _plain(learned.reference),
        "model_sha256": learned.model_sha256, "sample_rate_hz": learned.sample_rate_hz,
        "iterations": learned.iterations, "error_rms_um": learned.error_rms_um,
        "correction_um": learned.correction_um.tolist()}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_text(path, json.dumps(document, indent=1) + "\n")
    except OSError as error:
        raise LearnedFileError(f"cannot write {str(path)!r}: {error.strerror}; "
                               "give another directory") from None


def load_correction(path, reference, model_sha256, sample_rate_hz):
    """Read the correction of a file, which must have been learned for the same.

    Parameters
    ----------
    path : path-like
    reference : Reference
    model_sha256 : str
    sample_rate_hz : float

    Returns
    -------
    (P,) array

    Raises
    ------
    LearnedFileError
    """
    begin = f"the learned feedforward {str(path)!r}"
    try:
        document = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise LearnedFileError(f"{begin} cannot be read: {error.strerror}") from None
    except ValueError:
        raise LearnedFileError(f"{begin} is no JSON: learn anew") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise LearnedFileError(f"{begin} has another format than {FORMAT}: learn anew")
    if document.get("version") != VERSION:
        raise LearnedFileError(f"{begin} has version {document.get('version')}, not {VERSION}: "
                               "learn anew")
    for name, wanted in (("reference", _plain(reference)), ("model_sha256", model_sha256),
                         ("sample_rate_hz", sample_rate_hz)):
        if document.get(name) != wanted:
            raise LearnedFileError(f"{begin} was learned with another {name}: learn anew")
    try:
        correction_um = np.array(document["correction_um"], dtype=float)
    except (KeyError, TypeError, ValueError):
        correction_um = np.empty(0)
    if correction_um.ndim != 1 or not correction_um.size or not np.isfinite(correction_um).all():
        raise LearnedFileError(f"{begin} has no correction_um of finite numbers: learn anew")
    return correction_um


def _plain(reference):
    """The reference as it looks after a way through JSON."""
    return json.loads(json.dumps(dataclasses.asdict(reference)))
