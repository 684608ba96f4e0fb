# SPDX-License-Identifier: BSD-3-Clause
"""The experiments of a stage of several axes: each axis alone in turn, or all of them at once."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from piezo_identification.experiments.catalogue import Experiment, fitting, named_experiment
from piezo_identification.experiments.relay_feedback import RelayExperiment
from piezo_identification.experiments.stage_limits import StageLimits

MULTISINE_RMS = 0.03
"""RMS voltage of each axis as a fraction of its range: 4 V for 140 V, with peaks of up to 20 V."""

SETTLING_REPEATS, KEPT_REPEATS = 2, 2
"""Periods of a realisation: the creep after the approach fades in the first two, the others give
the noise."""

BLOCKS = 2
"""Sets of realisations, each with as many as axes. One set determines a response, a second its
scatter."""

SEED = 1
"""Seed of the phases, so that the waveform is the same each time."""


def axes_experiments(name: str, limits: Mapping[str, StageLimits]) -> list[Experiment]:
    """Make the experiments of one name for a stage of several axes, from the limits of each axis.

    In ``multisine``, all axes move at once, by orthogonal random phases. In ``validation``, all
    move at once, too, by a waveform that differs for each. In the other experiments of the
    catalogue, each axis moves alone in turn, while the others rest. The voltages of the experiments
    are (N, axes), and their names begin with the given one.

    Raise ValueError if the experiment acts in feedback, or for the reasons given in
    `named_experiment`.
    """
    if name == "multisine":
        return orthogonal_multisines(limits)
    designed = {axis: named_experiment(name, own) for axis, own in limits.items()}
    each: dict[str, Experiment] = {}
    for axis, experiment in designed.items():
        if isinstance(experiment, RelayExperiment):
            raise ValueError(f"experiment '{name}' acts in feedback, which takes a stage of one "
                             f"axis: this one has {', '.join(limits)}")
        each[axis] = experiment
    if name == "validation":
        return [_together(each, limits)]
    return [_alone(axis, experiment, limits) for axis, experiment in each.items()]


def orthogonal_multisines(
    limits: Mapping[str, StageLimits], period_s: float = 0.8, highest_hz: float = 3000.0,
) -> list[Experiment]:
    """Design multisines that move all axes at once, at the sample clock.

    There are as many realisations as axes, and the spectra of the axes are orthogonal at every
    line. The response is then obtained as if each axis had moved alone, with the power of all
    (Dobrowiecki and Schoukens, Automatica 43, 2007).

    `period_s` is the reciprocal of the line spacing, and `highest_hz` the highest excited
    frequency. Raise ValueError if a waveform leaves the range of an axis, or exceeds its slew
    limit.
    """
    axes = len(limits)
    first = next(iter(limits.values()))
    # Whole ticks, so that a period ends with a tick.
    samples = round(period_s * first.sample_rate_hz / first.samples_per_tick
                    ) * first.samples_per_tick
    lines_hz = np.fft.rfftfreq(samples, 1.0 / first.sample_rate_hz)
    played = (lines_hz > 0.0) & (lines_hz < min(highest_hz, 0.4 * first.sample_rate_hz))
    rng = np.random.default_rng(SEED)
    turned = np.exp(2j * np.pi * np.outer(np.arange(axes), np.arange(axes)) / axes)
    middle_v, span_v = (np.array([getattr(own, name) for own in limits.values()])
                        for name in ("middle_v", "span_v"))
    found: list[Experiment] = []
    for _ in range(BLOCKS):
        phases = np.where(played[:, None], np.exp(2j * np.pi * rng.random((lines_hz.size, axes))),
                          0.0)
        for turns in turned:
            waves = np.fft.irfft(phases * turns, samples, axis=0)
            voltage_v = middle_v + MULTISINE_RMS * span_v * waves / np.std(waves, axis=0)
            found.append(_fitting(Experiment(
                f"multisine_{len(found) + 1}", voltage_v, 1.0 / first.sample_rate_hz,
                SETTLING_REPEATS + KEPT_REPEATS,
                f"all axes by lines of {1.0 / period_s:g} Hz up to {highest_hz:g} Hz",
                SETTLING_REPEATS), limits))
    return found


def _alone(axis: str, experiment: Experiment, limits: Mapping[str, StageLimits]) -> Experiment:
    """Return an experiment in which one axis moves and the others rest."""
    voltage_v = np.tile([own.rest_voltage_v for own in limits.values()],
                        (len(experiment.voltage_v), 1))
    voltage_v[:, list(limits).index(axis)] = experiment.voltage_v
    return Experiment(f"{experiment.name}_{axis}", voltage_v, experiment.sample_period_s,
                      experiment.repeats, f"{axis} alone: {experiment.description}")


def _together(each: Mapping[str, Experiment], limits: Mapping[str, StageLimits]) -> Experiment:
    """Return all axes at once, each delayed against the one before so that they differ."""
    first, last = next(iter(each.values())), len(each) - 1
    step = len(first.voltage_v) // (2 * len(each))
    voltage_v = np.column_stack([
        np.pad(experiment.voltage_v, (number * step, (last - number) * step), "edge")
        for number, experiment in enumerate(each.values())])
    return _fitting(Experiment(
        first.name, voltage_v, first.sample_period_s, first.repeats,
        f"all axes, one after the other: {first.description}"), limits)


def _fitting(experiment: Experiment, limits: Mapping[str, StageLimits]) -> Experiment:
    """Return the experiment; raise ValueError if an axis cannot play it unchanged."""
    fitted = []
    for (axis, own), column in zip(limits.items(), experiment.voltage_v.T, strict=True):
        try:
            fitted.append(fitting(own, replace(experiment, voltage_v=column)).voltage_v)
        except ValueError as refused:
            raise ValueError(f"{axis}: {refused}") from None
    return replace(experiment, voltage_v=np.column_stack(fitted))
