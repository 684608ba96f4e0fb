# SPDX-License-Identifier: BSD-3-Clause
"""The file of a learned feedforward: one versioned JSON document."""

import dataclasses
import hashlib
import json
import math
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydantic import ConfigDict

from piezo_common.arrays import FloatArray
from piezo_common.schema import Document, Number, Numbers, SchemaError, entry, load_document
from piezo_common.text_file import PREVIOUS, replace_document
from piezo_controller.references.kind import Reference

FORMAT = "piezo_learned_feedforward"
VERSION = 1
MOST_FACTOR = 2.0
"""Largest factor between the amplitudes of similar references."""


class LearnedFileError(ValueError):
    """A file of a learned feedforward that cannot be used; the message gives path and cure."""


class LearnedDocument(Document):
    """The file of a learned feedforward: a correction, and the reference it was learned for."""

    # Entries that a later release adds must not keep an older one from playing the correction.
    model_config = ConfigDict(extra="ignore")

    TITLE: ClassVar[str] = "learned feedforward"
    FORMAT: ClassVar[str] = FORMAT
    VERSION: ClassVar[int] = VERSION
    RENEW: ClassVar[str] = "learn again"

    format: str = entry(f"Always {FORMAT}.")
    version: Number = entry(f"Always {VERSION}.")
    reference: dict[str, Any] = entry("The reference, field by field as in the message.")
    model_sha256: str = entry("Hash of the model file.")
    sample_rate_hz: Number = entry("Rate of the correction.", unit="Hz", above=0.0)
    iterations: Any = entry("How many periods were learned from; a note.", default=None)
    error_rms_um: Any = entry("Error of the learned harmonics at its best; a note.", unit="um",
                              default=None)
    correction_um: Numbers = entry(
        "One period of what is added to the reference.", unit="um", shortest=1)


def learned_path(directory: str | Path, reference: Reference, model_sha256: str) -> Path:
    """Return the path in a directory for what was learned of a reference with a model."""
    key = json.dumps([_plain(reference), model_sha256], sort_keys=True)
    return Path(directory) / f"learned_{hashlib.sha256(key.encode()).hexdigest()[:16]}.json"


def save_learned(path: str | Path, reference: Reference, model_sha256: str, sample_rate_hz: float,
                 correction_um: FloatArray, error_rms_um: float, iterations: int) -> None:
    """Write a correction, (P,), and its conditions atomically, replacing an existing file."""
    path = Path(path)
    document = {
        "format": FORMAT, "version": VERSION, "reference": _plain(reference),
        "model_sha256": model_sha256, "sample_rate_hz": sample_rate_hz,
        "iterations": iterations, "error_rms_um": error_rms_um,
        "correction_um": correction_um.tolist()}
    with suppress(OSError):  # reported when the file is written
        path.parent.mkdir(parents=True, exist_ok=True)
    replace_document(path, document, "file of a learned correction", LearnedFileError)


def load_correction(path: str | Path, reference: Reference, model_sha256: str,
                    sample_rate_hz: float) -> FloatArray:
    """Read the correction of a file that was learned for the same conditions, (P,).

    Raises `LearnedFileError` if there is none.
    """
    begin = f"the learned feedforward {str(path)!r}"
    try:
        document = load_document(LearnedDocument, path)
    except SchemaError as error:
        raise LearnedFileError(f"{begin}: {error.problem}; learn again") from None
    for name, wanted in (("reference", _plain(reference)), ("model_sha256", model_sha256),
                         ("sample_rate_hz", sample_rate_hz)):
        if getattr(document, name) != wanted:
            raise LearnedFileError(f"{begin} was learned with another {name}: learn again")
    return np.array(document.correction_um)


def find_like(directory: str | Path, reference: Reference, model_sha256: str,
              sample_rate_hz: float) -> tuple[Path, FloatArray] | None:
    """Find the file of the similar reference with the nearest amplitude and centre.

    References are similar if they differ only in their centre and in a common factor of all
    amplitudes: the errors of a model grow about in proportion to the amplitude. The correction,
    (P,), is scaled with the amplitude.
    """
    found = []
    for path in sorted(Path(directory).glob("learned_*.json")):
        if path.stem.endswith(PREVIOUS):
            continue
        try:
            document = load_document(LearnedDocument, path)
        except SchemaError:
            continue
        factor, shift_um = _likeness(reference, document.reference)
        known = document.model_sha256, document.sample_rate_hz
        if known == (model_sha256, sample_rate_hz) and 1 / MOST_FACTOR <= factor <= MOST_FACTOR:
            far = abs(math.log(factor)) + shift_um / sum(reference.amplitude_um)
            found.append((far, path, factor * np.array(document.correction_um)))
    if not found:
        return None
    _, path, correction_um = min(found, key=lambda one: one[0])
    return path, correction_um


def _likeness(reference: Reference, other: dict[str, Any]) -> tuple[float, float]:
    """Return the amplitude ratio of two references, and the distance of their centres (um).

    The ratio is zero if they are not similar.
    """
    wanted = _plain(reference)
    differing = {name for name in wanted if wanted[name] != other.get(name)}
    if not differing <= {"amplitude_um", "centre_um"} or not wanted["amplitude_um"]:
        return 0.0, 0.0
    try:
        ratios = np.divide(wanted["amplitude_um"], other["amplitude_um"])
        shift_um = abs(wanted["centre_um"] - other["centre_um"])
    except (TypeError, ValueError):
        return 0.0, 0.0
    return float(ratios[0]) if np.ptp(ratios) <= 1e-9 * ratios[0] else 0.0, shift_um


def _plain(reference: Reference) -> dict[str, Any]:
    """Return the reference as it reads after conversion to JSON and back."""
    return json.loads(json.dumps(dataclasses.asdict(reference)))
