# SPDX-License-Identifier: BSD-3-Clause
"""Record the simulated stage in shorter ways, identify, and write the errors into docs/recipe.md.

The stage is that of the demo, with 9 nm of sensor noise. Every trial changes one condition. The
errors are relative errors (4.20) in percent on recordings that no trial was fitted to.
"""

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from piezo_identification.estimators.creep.square_wave_creep import estimate_creep
from piezo_identification.estimators.dynamics.fast_estimate import estimate_dynamics
from piezo_identification.estimators.hysteresis.density_fit import estimate_density
from piezo_identification.experiments import catalogue
from piezo_identification.experiments.input_designs import arc
from piezo_identification.experiments.stage_limits import StageLimits
from piezo_identification.prediction.prediction import predict
from piezo_models.cascade import StageModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording
from piezo_studies.marked_sections import with_sections
from piezo_studies.tables import markdown_table
from piezo_studies.thesis.laboratory import CLOCK_HZ, ROWS_LATE, record_experiment, record_stage

SLOW_HZ, CREEP_HZ = 1000.0, 100.0
LEVELS, HARMONIC_S, CREEP_S, DYNAMICS_S = 20, 2.0, 400.0, 2.0
"""Values in trials that do not vary them; 20 levels keep the whole study short."""

LEVEL_COUNTS = (3, 5, 10, 20)
SAMPLES_PER_HARMONIC = (50, 2000)
CREEP_PERIODS_S = (20.0, 50.0, 100.0, 400.0)
CREEP_RATES_HZ = (2.0, 10.0, 100.0)
FAST_RATES_HZ = (1250.0, 2500.0, 5000.0, 40_000.0)
DYNAMICS_DURATIONS_S = (0.6, 1.0, 2.0)
MIDDLE_TURNS = (0.45, 0.72, 0.31, 0.66, 0.38, 0.58, 0.45)
"""Turning points of a motion about the middle, as fractions of the range."""
STEP_LEVELS = (0.2, 0.7, 0.35)
STEP_S, TONES_S, ARC_S = 100.0, 0.25, 0.25


@dataclass(frozen=True)
class Trial:
    """One way to record, and the resulting error."""

    asked: str
    """Changed condition."""
    recorded_s: float
    samples: int

    error_percent: float
    """Error on unseen data."""


LIMITS = StageLimits()


@cache
def linear_parts() -> tuple[CreepDynamics, ElectricVibrationDynamics]:
    """Identify creep and dynamics from the full recordings."""
    slow, quick = creep_recording(CREEP_S), dynamics_recording(CLOCK_HZ, DYNAMICS_S)
    dynamics = estimate_dynamics(quick, estimate_creep(slow).model, delay=ROWS_LATE).model
    creep = estimate_creep(slow, dynamics).model
    return creep, estimate_dynamics(quick, creep, delay=ROWS_LATE).model


@cache
def usual_model() -> StageModel:
    """Identify the model whose unchanged components are used in the trials."""
    return model_of(hysteresis_recording(LEVELS, SLOW_HZ))


def model_of(harmonics: Recording) -> StageModel:
    """Identify the hysteresis from a recording, with the usual creep and dynamics."""
    creep, dynamics = linear_parts()
    return StageModel(estimate_density(harmonics, creep, dynamics).model(), creep, dynamics)


def hysteresis_recording(levels: int, rate_hz: float) -> Recording:
    """Record harmonics of rising amplitude as means of samples at a rate."""
    experiment = catalogue.hysteresis(LIMITS, levels, HARMONIC_S, 1.0 / rate_hz)
    return record_experiment(experiment, seed=3)


def creep_recording(period_s: float, rate_hz: float = CREEP_HZ) -> Recording:
    """Record one period of the long square wave."""
    experiment = catalogue.creep(LIMITS, period_s, 1.0 / rate_hz)
    return record_experiment(experiment, seed=1)


def dynamics_recording(rate_hz: float, duration_s: float) -> Recording:
    """Record the short square wave."""
    limits = StageLimits(sample_rate_hz=rate_hz)
    return record_experiment(catalogue.dynamics(limits, duration_s=duration_s), rate_hz, seed=2)


@cache
def unseen_loops() -> Recording:
    """Record slow arcs between turning points between the levels."""
    turns = catalogue.VALIDATION_TURNS
    return _recorded(_arcs(turns), SLOW_HZ, 4)


@cache
def unseen_steps() -> Recording:
    """Record long steps to levels that the creep experiment does not have."""
    return _recorded(np.repeat(STEP_LEVELS, round(STEP_S * CREEP_HZ)), CREEP_HZ, 5)


@cache
def unseen_tones() -> Recording:
    """Record the tones of the validation experiment on the fastest clock."""
    experiment = catalogue.validation(LIMITS, tones_s=TONES_S)
    return record_experiment(experiment, seed=6)


def number_of_levels() -> Iterator[Trial]:
    """Vary the number of harmonics, which is that of levels."""
    for levels in LEVEL_COUNTS:
        model = (usual_model() if levels == LEVELS
                 else model_of(hysteresis_recording(levels, SLOW_HZ)))
        yield Trial(f"{levels} levels", levels * HARMONIC_S,
                    round(levels * HARMONIC_S * SLOW_HZ), _error(model, unseen_loops()))


def rate_of_the_hysteresis() -> Iterator[Trial]:
    """Vary the number of samples in a harmonic."""
    for samples in SAMPLES_PER_HARMONIC:
        rate_hz = samples / HARMONIC_S
        model = (usual_model() if rate_hz == SLOW_HZ
                 else model_of(hysteresis_recording(LEVELS, rate_hz)))
        yield Trial(f"{samples} samples a harmonic ({rate_hz:g} Hz)", LEVELS * HARMONIC_S,
                    LEVELS * samples, _error(model, unseen_loops()))


def length_of_the_creep() -> Iterator[Trial]:
    """Vary the period of the long square wave."""
    for period_s in CREEP_PERIODS_S:
        yield _creep_trial(f"a period of {period_s:g} s", period_s, CREEP_HZ)


def rate_of_the_creep() -> Iterator[Trial]:
    """Vary the rate of the long square wave."""
    for rate_hz in CREEP_RATES_HZ:
        yield _creep_trial(f"{rate_hz:g} Hz", CREEP_S, rate_hz)


def rate_of_the_dynamics() -> Iterator[Trial]:
    """Vary the clock of the short square wave."""
    for rate_hz in FAST_RATES_HZ:
        yield _dynamics_trial(f"{rate_hz / 1e3:g} kHz", rate_hz, DYNAMICS_S)


def length_of_the_dynamics() -> Iterator[Trial]:
    """Vary the duration of the short square wave."""
    for duration_s in DYNAMICS_DURATIONS_S:
        yield _dynamics_trial(f"{duration_s:g} s", CLOCK_HZ, duration_s)


def sweep_before() -> Iterator[Trial]:
    """Omit or record a sweep over the full range before a motion about the middle."""
    middle = _arcs(MIDDLE_TURNS)
    sweep = _arcs((0.0, 1.0, 0.0, MIDDLE_TURNS[0]))
    # An earlier motion that is not in the recording.
    past_v = _volts(_arcs((0.0, 0.9, 0.25, 0.62, MIDDLE_TURNS[0])))
    for text, waveform in (("none", middle), ("one, recorded", np.r_[sweep, middle])):
        recorded = record_stage("middle", _volts(waveform), past_v, _held(SLOW_HZ), seed=7)
        recorded = recorded.select(recorded.playing)
        prediction = predict(usual_model(), recorded)
        about_middle = prediction.time_s > prediction.time_s[-1] - middle.size / SLOW_HZ
        yield Trial(text, waveform.size / SLOW_HZ, waveform.size,
                    prediction.e_y_percent(about_middle))


TABLES: dict[str, tuple[str, str, Callable[[], Iterator[Trial]]]] = {
    "levels": ("levels of the hysteresis", "unseen slow loops", number_of_levels),
    "hysteresis_rate": ("rate of the hysteresis", "unseen slow loops", rate_of_the_hysteresis),
    "creep": ("long square wave", f"unseen steps of {STEP_S:g} s", length_of_the_creep),
    "creep_rate": ("rate of the long square wave", f"unseen steps of {STEP_S:g} s",
                   rate_of_the_creep),
    "dynamics_rate": ("clock of the dynamics", "unseen tones", rate_of_the_dynamics),
    "dynamics_length": ("length of the dynamics", "unseen tones", length_of_the_dynamics),
    "sweep": ("sweep before the recording", "the motion about the middle", sweep_before),
}
"""Varied condition, predicted data and trials of each table, by its name in the page."""


def _creep_trial(text: str, period_s: float, rate_hz: float) -> Trial:
    usual = usual_model()
    creep = estimate_creep(creep_recording(period_s, rate_hz), usual.dynamics).model
    return Trial(text, period_s, round(period_s * rate_hz),
                 _error(StageModel(usual.hysteresis, creep, usual.dynamics), unseen_steps()))


def _dynamics_trial(text: str, rate_hz: float, duration_s: float) -> Trial:
    usual = usual_model()
    dynamics = estimate_dynamics(
        dynamics_recording(rate_hz, duration_s), usual.creep, delay=ROWS_LATE).model
    model = StageModel(usual.hysteresis, usual.creep, dynamics)
    prediction = predict(model, unseen_tones())
    tones = prediction.time_s > prediction.time_s[-1] - TONES_S
    measured_um, simulated_um = prediction.measured_um[tones], prediction.simulated_um[tones]
    # Remove the offset, which is an error of the hysteresis and not of the dynamics.
    error_um = measured_um - simulated_um
    return Trial(text, duration_s, round(duration_s * rate_hz),
                 100.0 * float(error_um.std() / measured_um.std()))


def _error(model: StageModel, recording: Recording) -> float:
    return predict(model, recording).e_y_percent()


def _arcs(turns: tuple[float, ...]) -> np.ndarray:
    samples = round(ARC_S * SLOW_HZ)
    return np.concatenate([arc(start, end, samples)
                           for start, end in zip(turns[:-1], turns[1:], strict=True)])


def _volts(part: np.ndarray) -> np.ndarray:
    return LIMITS.voltage_min_v + LIMITS.span_v * part


def _held(rate_hz: float) -> int:
    return round(CLOCK_HZ / rate_hz)


def _recorded(part: np.ndarray, rate_hz: float, seed: int) -> Recording:
    voltage_v = _volts(part)
    before_v = np.linspace(0.0, voltage_v[0], max(1, round(0.1 * rate_hz)))
    return record_stage("unseen", voltage_v, before_v, _held(rate_hz), seed=seed)


SECTIONS = "trials of "
"""Beginning of the marks of the tables in the page."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="recording_recipe", description=__doc__)
    parser.add_argument("--page", type=Path, default=Path("docs/recipe.md"),
                        help="page whose tables are written again; its text stays")
    options = parser.parse_args(arguments)
    made: dict[str, list[Trial]] = {}
    for name, (_, _, trials) in TABLES.items():
        made[name] = []
        for trial in trials():
            made[name].append(trial)
            print(f"{name}: {trial.asked}: {trial.error_percent:.2g} %", file=sys.stderr,
                  flush=True)
    options.page.write_text(page(options.page.read_text(encoding="utf-8"), made),
                            encoding="utf-8")
    print(f"{sum(len(each) for each in made.values())} trials: {options.page}")


def page(text: str, made: dict[str, list[Trial]]) -> str:
    """Return the text of a page with its tables replaced; ValueError if it has other sections."""
    tables = {SECTIONS + name: table(name, trials) for name, trials in made.items()}
    return with_sections(text, tables, SECTIONS)


def table(name: str, trials: Iterable[Trial]) -> str:
    """Return the rows of a table as Markdown."""
    varied, predicted, _ = TABLES[name]
    return markdown_table(
        (varied, "recorded for", "samples", f"error on {predicted}"),
        [(trial.asked, f"{trial.recorded_s:.3g} s", str(trial.samples),
          f"{trial.error_percent:.2g} %") for trial in trials])


if __name__ == "__main__":
    main()
