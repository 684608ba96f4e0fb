# SPDX-License-Identifier: BSD-3-Clause
"""Results of the calls of a stage; each can be used as the path of the file it describes."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from piezo_recorder.reading.reader import read_recording
from piezo_recorder.reading.recording import Recording

if TYPE_CHECKING:
    from piezo_models.identified_model import IdentifiedModel


class _AtPath:
    path: Path

    def __fspath__(self) -> str:
        return str(self.path)


class _ModelFile(_AtPath):
    def model(self) -> "IdentifiedModel":
        """Read the model file; return a `piezo_models.identified_model.IdentifiedModel`."""
        # Imported here, since it takes seconds, which a client that only drives the stage can save.
        from piezo_models.model_file import load_model

        return load_model(self.path)


@dataclass(frozen=True)
class _Run(_AtPath):
    path: Path
    """Path of the recording."""

    def recording(self) -> Recording:
        """Read the samples; return a `piezo_recorder.reading.recording.Recording`."""
        return read_recording(self.path, several_axes=True)


@dataclass(frozen=True)
class Played(_Run):
    """A waveform that was played."""


@dataclass(frozen=True)
class Experiment(_Run):
    """An experiment that was run."""

    summary: str
    """What was played and, for a relay experiment, its result."""


@dataclass(frozen=True)
class Tracking(_Run):
    """A reference that was tracked."""

    e_rms_percent: float
    """RMS error by the sensor, in percent of the reference's peak-to-peak value (2.32)."""
    largest_error_um: float
    missed_feedback: int
    """Responses of the controller that came too late."""
    message: str
    """Remarks on the run, for example what the feedforward does not compensate, or that an
    extended model was used; empty if there are none."""


@dataclass(frozen=True)
class Identification(_ModelFile):
    """A stage that was identified; accepted wherever a model file is."""

    path: Path
    """Path of the model file."""
    errors: dict[str, float]
    """Errors on data that was not fitted."""
    recordings: tuple[Path, ...]
    """Recordings of the experiments."""
    adequacy: str = ""
    """One of "adequate" if the residual of every component is at most the noise of its recording,
    else "inadequate"; empty if that was not tested."""
    components: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Adequacy of each component, as in the model file."""
    message: str = ""
    """Remarks, for example where an earlier model is kept; empty if there are none."""


@dataclass(frozen=True)
class Diagnosis(_ModelFile):
    """What a model lacks; accepted wherever a model file is, as the extended model."""

    verdict: str
    """``none``, ``explained`` or ``unexplained``."""
    sentence: str
    """The verdict in words."""
    effects: tuple[str, ...]
    """Effects that the model lacks, the strongest first."""
    path: Path
    """Path of the extended model."""
    report: Path
    """Path of the HTML report."""
    details: dict[str, Any]
    """Content of ``verdict.json``."""
    decision: str = ""
    """Conclusion from the experiments that were played; empty if none was requested."""
    experiments: tuple[Path, ...] = ()
    """Recordings of these experiments."""


@dataclass(frozen=True)
class OfferedModel(_AtPath):
    """A model that the monitor offers; accepted wherever a model file is."""

    path: Path
    """Path of the extended model."""
    model: Path
    """Path of the model that it extends."""
    sentence: str
    """Description of the change of the stage."""
    since_s: float
    """Time of the sample clock at which the change began."""
    before_rms_um: float
    after_rms_um: float
    """RMS residual since then with the model and with the extended model."""
