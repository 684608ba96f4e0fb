# SPDX-License-Identifier: BSD-3-Clause
"""What the calls of a stage return; each may stand for the path of what it made."""

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
        """Read the model file: a `piezo_models.identified_model.IdentifiedModel`."""
        # Its imports take seconds, which a client that only drives the stage need not wait for.
        from piezo_models.model_file import load_model

        return load_model(self.path)


@dataclass(frozen=True)
class _Run(_AtPath):
    path: Path

    def recording(self) -> Recording:
        """Read the samples: a `piezo_recorder.reading.recording.Recording`."""
        return read_recording(self.path, several_axes=True)


@dataclass(frozen=True)
class Played(_Run):
    """A waveform that was played.

    Attributes
    ----------
    path : Path
        Of the recording.
    """


@dataclass(frozen=True)
class Experiment(_Run):
    """An experiment that was run.

    Attributes
    ----------
    path : Path
        Of the recording.
    summary : str
        What was played and, of a relay experiment, what was found.
    """

    summary: str


@dataclass(frozen=True)
class Tracking(_Run):
    """A reference that was tracked.

    Attributes
    ----------
    path : Path
        Of the recording.
    e_rms_percent : float
        RMS error by the sensor, of the reference's peak to peak (2.32).
    missed_feedback : int
        Answers of the controller that came too late.
    message : str
        What is to be told of the run, such as what the feedforward leaves uncompensated, or that
        an extended model was used; empty where nothing is.
    """

    e_rms_percent: float
    largest_error_um: float
    missed_feedback: int
    message: str


@dataclass(frozen=True)
class Identification(_ModelFile):
    """A stage that was identified; may be given wherever a model file is asked for.

    Attributes
    ----------
    path : Path
        Of the model file.
    errors : dict of str to float
        On data that was not fitted.
    recordings : tuple of Path
        Of the experiments.
    adequacy : str
        "adequate" if every component leaves no more than noise of its own recording, else
        "inadequate"; empty if that was not tested.
    components : dict of str to dict
        The same of each component, as the model file holds it.
    """

    path: Path
    errors: dict[str, float]
    recordings: tuple[Path, ...]
    adequacy: str = ""
    components: dict[str, dict[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Diagnosis(_ModelFile):
    """What a model lacks; may be given wherever a model file is asked for: the extended one.

    Attributes
    ----------
    verdict : str
        ``none``, ``explained`` or ``unexplained``.
    sentence : str
        The verdict in words.
    effects : tuple of str
        That the model lacks, the strongest first.
    path : Path
        Of the extended model's file.
    report : Path
        HTML page.
    details : dict
        Content of ``verdict.json``.
    decision : str
        What the experiments that were played have decided; empty where none was asked for.
    experiments : tuple of Path
        Their recordings.
    """

    verdict: str
    sentence: str
    effects: tuple[str, ...]
    path: Path
    report: Path
    details: dict[str, Any]
    decision: str = ""
    experiments: tuple[Path, ...] = ()


@dataclass(frozen=True)
class OfferedModel(_AtPath):
    """A model that the monitor offers; may be given wherever a model file is asked for.

    Attributes
    ----------
    path : Path
        Of the extended model's file.
    model : Path
        Of the model that it extends.
    sentence : str
        What the stage has changed.
    since_s : float
        Time of the sample clock at which the change began.
    before_rms_um, after_rms_um : float
        Of the residual since then, of the model and of the extended one.
    """

    path: Path
    model: Path
    sentence: str
    since_s: float
    before_rms_um: float
    after_rms_um: float
