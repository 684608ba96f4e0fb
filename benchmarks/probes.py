# SPDX-License-Identifier: BSD-3-Clause
"""Probe files, from which the experiments of a directory take their lengths."""

from piezo_identification.experiments.catalogue import SWING_FRACTION, VALIDATION_TONES
from piezo_identification.experiments.probing import probe_file
from piezo_identification.experiments.stage_limits import USUAL_LIMITS

ENDLESS_S = 100_000.0
"""Of stage time: days of a paced stage, and more than an hour of one in lockstep."""
SHORT_TONES = {"arc_s": 0.05, "tones_s": 0.2, "tones": [list(tone) for tone in VALIDATION_TONES]}
"""Of the validation and the multisine of a short probe."""


def write_endless_probe(directory):
    """Let experiments last longer than anybody asks, on any machine."""
    tones = {"arc_s": 0.5, "tones_s": ENDLESS_S, "tones": [[100.0, 0.1]]}
    held_s = {"sample_period_s": 1e-3}
    _write(directory, {
        "creep": {"swing_v": 20.0, "period_s": 1.0, **held_s},
        "dynamics": {"swing_v": 20.0, "period_s": 0.02, "duration_s": ENDLESS_S},
        "hysteresis": {"level_count": 2, "harmonic_period_s": 1.0, **held_s},
        "validation": tones, "multisine": tones, "relay": {"oscillation_s": ENDLESS_S}})


def write_short_probe(directory, limits=USUAL_LIMITS):
    """Let the experiments of an identification take an eighth of their time."""
    swing_v = SWING_FRACTION * limits.span_v
    _write(directory, {
        "creep": {"swing_v": swing_v, "period_s": 60.0, "sample_period_s": 0.01},
        "dynamics": {"swing_v": swing_v, "period_s": 0.02, "duration_s": 0.3},
        "hysteresis": {"level_count": 10, "harmonic_period_s": 0.5, "sample_period_s": 1e-3},
        "validation": SHORT_TONES, "multisine": SHORT_TONES,
        "relay": {"oscillation_s": 1.0}}, limits)


def _write(directory, experiments, limits=USUAL_LIMITS):
    document = probe_file.ProbeDocument.model_validate({
        "format": probe_file.FORMAT, "version": float(probe_file.VERSION),
        "limits": {name: getattr(limits, name) for name in probe_file.OF_THE_LIMITS},
        "stage": {
            "step_v": 10.0, "signal_to_noise": 100.0, "rest_level_um": 0.0, "noise_rms_um": 0.01,
            "gain_um_per_v": 1.0, "lag_s": 0.0, "settling_s": 0.01, "modes": [],
            "creep_share_per_decade": 0.0, "creep_time_s": 0.0, "creep_ended": True},
        "range": {"voltage_min_v": limits.voltage_min_v,
                  "voltage_max_v": limits.voltage_max_v},
        "experiments": experiments,
        "expected": {"creep_percent": 0.0, "dynamics_percent": 0.0, "hysteresis_percent": 0.0,
                     "model_percent": 0.0, "remarks": []}})
    probe_file.save_probe(directory / probe_file.NAME, document)
