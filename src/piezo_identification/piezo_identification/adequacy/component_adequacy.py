# SPDX-License-Identifier: BSD-3-Clause
"""The verdict on each component of a model: its residual compared with the noise."""

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from piezo_common.side_by_side import side_by_side
from piezo_identification.adequacy.component_residual import component_residual
from piezo_identification.adequacy.lack_of_fit import lack_of_fit
from piezo_identification.adequacy.residual_location import residual_location
from piezo_identification.conditioning.segments import experiment_of, testable
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_models.cascade import StageModel
from piezo_recorder.reading.recording import Recording

ADEQUATE, INADEQUATE = "adequate", "inadequate"

COMPONENTS = ("creep", "dynamics", "hysteresis")
"""Components, named like the recordings from which they are estimated."""

NUMBERS = {"creep": "--creep-pairs", "dynamics": "--modes"}
"""Options that set the number of modes or creep pairs of a component."""

FAR_ABOVE = 3.0
"""Ratio of the error on unseen motion to the noise above which an adequate model is doubted."""

SLOW_HZ = 5.0
"""Frequency below which a residual of loops may be creep; above it, fast dynamics."""


@dataclass(frozen=True)
class ComponentAdequacy:
    """How well a component fits the recording that it was estimated from."""

    residual_rms_um: float
    noise_rms_um: float
    ratio: float
    """RMS of the residual, RMS of the noise in the same samples, and their ratio; of the mean
    period if the voltage is periodic."""
    verdict: str
    """`ADEQUATE` or `INADEQUATE`."""
    error_percent: float
    """Relative error e_y (4.20) on the data that were fitted."""
    noise_from: str
    """Source of the noise estimate."""
    left: str = ""
    """Size and location of the systematic error; empty if adequate."""
    advice: str = ""
    """Recommended action; empty if adequate."""


def adequacy_of(
    model: StageModel, recordings: Mapping[str, Any],
    delays_s: Mapping[str, float] | None = None,
    asked_for: Collection[str] = (),
) -> dict[str, ComponentAdequacy]:
    """Compare the residual of each component on its recordings with the noise.

    The conditioned data, without gaps, are given by the names of `COMPONENTS`; further recordings
    of a component are numbered: creep, creep 2. Other names are ignored. `delays_s` are the delays
    of rows by name of the recording, in addition to those of the model, and `asked_for` the
    components whose number of parts was given by the user. The result has the names of the
    recordings; short stretches are omitted.
    """
    delays_s, tested = delays_s or {}, testable(recordings)
    names = [name for component in COMPONENTS for name in tested
             if experiment_of(name) == component]
    return dict(zip(names, side_by_side(lambda name: _component_adequacy(
        experiment_of(name), model, tested[name], delays_s.get(name, 0.0), recordings,
        experiment_of(name) in asked_for), names), strict=True))


def unseen_errors_beyond_noise(
    model: StageModel, recordings: Mapping[str, Any], delays_s: Mapping[str, float],
) -> list[str]:
    """Return a sentence for each recording of the validation whose error is far above its noise.

    Components that fit their own recordings say nothing of motion that these do not contain.
    """
    sentences = []
    for name, data in testable(recordings).items():
        if experiment_of(name) != "validation":
            continue
        fit = lack_of_fit(component_residual(
            "hysteresis", model, data, delays_s.get(name, 0.0)))
        if not fit.is_adequate and fit.ratio > FAR_ABOVE:
            sentences.append(
                f"the error on {data.path}, which was not fitted, is {fit.residual_rms_um:.3g} um, "
                f"{fit.ratio:.3g} times the noise, although each component fits its own recording: "
                "these recordings do not show all that the model needs; record what is missing, "
                "such as loops for --hysteresis, or fast motion for --dynamics")
    return sentences


def _component_adequacy(
    component: str, model: StageModel, data: Recording | FrequencyResponse, delay_s: float,
    recordings: Mapping[str, Any], is_asked_for: bool,
) -> ComponentAdequacy:
    residual = component_residual(component, model, data, delay_s)
    fit = lack_of_fit(residual)
    left = advice = ""
    if not fit.is_adequate:
        band_hz, words = residual_location(residual, fit)
        left = f"{fit.systematic_rms_um:.3g} um beyond the noise, {words}"
        advice = advice_on(component, model, band_hz, residual.path, recordings, is_asked_for)
    return ComponentAdequacy(
        fit.residual_rms_um, fit.noise_rms_um, fit.ratio,
        ADEQUATE if fit.is_adequate else INADEQUATE, residual.error_percent, fit.noise_from, left,
        advice)


def advice_on(component: str, model: StageModel, band_hz: tuple[float, float], path: str,
              recordings: Mapping[str, Any], is_asked_for: bool = False) -> str:
    """Return advice on an inadequate component, whose number of parts the user may have given."""
    steps = []
    if component == "hysteresis":
        slow = band_hz[1] < SLOW_HZ
        missing = "creep" if slow else "dynamics"
        if missing not in recordings:
            steps.append(f"give a recording for --{missing}" + (
                f", if only {path} once more" if slow else ""))
    elif component == "creep":
        steps.append("record the creep longer")
    elif "hysteresis" not in recordings and model.has_hysteresis:
        steps.append("give a recording for --hysteresis, which was taken from the fast one alone")
    if is_asked_for:
        steps.append(f"leave {NUMBERS[component]} out, so that the number is sought")
    steps.append(f"let diagnose name the cause from {path}")
    return ", or ".join(steps)


def adequacy_document(adequacy: Mapping[str, ComponentAdequacy]) -> dict[str, dict[str, Any]]:
    """Return the adequacy as plain numbers and strings for the model file."""
    return {component: {name: value for name, value in asdict(part).items() if value != ""}
            for component, part in adequacy.items()}


def overall_verdict(document: Mapping[str, Mapping[str, Any]]) -> str:
    """Return `ADEQUATE` if every part of an `adequacy_document` is, else `INADEQUATE`.

    It is empty if no component was tested.
    """
    verdicts = {part["verdict"] for part in document.values()}
    if not verdicts:
        return ""
    return ADEQUATE if verdicts == {ADEQUATE} else INADEQUATE


def adequacy_table(document: Mapping[str, Mapping[str, Any]]) -> str:
    """Return an `adequacy_document` as a text table, followed by residuals and advice."""
    lines = [f"{'on the data that were fitted':28}{'residual (um)':>14}{'noise (um)':>12}"
             f"{'ratio':>10}{'e_y (%)':>10}"]
    lines += [f"{component:30}{part['residual_rms_um']:12.3g}{part['noise_rms_um']:12.3g}"
              f"{part['ratio']:10.3g}{part['error_percent']:10.3g}  {part['verdict']}"
              for component, part in document.items()]
    lines += [f"{component} is inadequate: {part['left']}; {part['advice']}"
              for component, part in document.items() if part["verdict"] == INADEQUATE]
    return "\n".join(lines)
