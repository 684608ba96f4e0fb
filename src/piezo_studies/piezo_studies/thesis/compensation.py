# SPDX-License-Identifier: BSD-3-Clause
"""Section 2.3.3: feedforward by the inverse of the identified hysteresis, and an integral action.

The stage is the hysteresis of section 2.2.4 with an offset at its output. The model is its estimate
from one sine.
"""

import numpy as np

from piezo_models.hysteresis.preisach import PreisachModel
from piezo_studies.baselines.svd_estimate import density_by_svd, truncated_svd
from piezo_studies.thesis.figure_table import Row, Study
from piezo_studies.thesis.one_sine import (
    DENSITY,
    HIGHEST_V,
    LEVELS,
    RANK,
    SAMPLE_PERIOD_S,
    SAMPLES,
    input_v,
    one_sine,
)

PROPORTIONAL, INTEGRAL_PER_S = 0.001, 3.0
# At a reference of 0 um, an offset of +5 um would need a voltage below 0 V, outside the plane.
OFFSET_UM = -5.0
DURATION_S = 10.0
SECTION = "2.3.3"


def study():
    """Compute the RMS tracking errors."""
    time_s = np.arange(0.0, DURATION_S, SAMPLE_PERIOD_S)
    reference_um = 20.0 * (1.0 - np.cos(2.0 * np.pi * time_s))
    voltage_v = estimated_model().invert(reference_um)
    feedforward_um = track(reference_um, voltage_v, 0.0, 0.0)
    composite_um = track(reference_um, voltage_v, PROPORTIONAL, INTEGRAL_PER_S)
    settled = time_s >= 1.0
    return Study([
        Row(SECTION, "RMS error, feedforward", 5.02, _rms(reference_um - feedforward_um), "um",
            "almost all of it the offset of 5 um; taken as -5 um, because +5 um needs less than "
            "0 V"),
        Row(SECTION, "RMS error, feedforward, offset removed", None,
            float(np.std(reference_um - feedforward_um)), "um",
            "0.45 um remain of the thesis' 5.02 um"),
        Row(SECTION, "RMS error, composite", 0.22, _rms(reference_um - composite_um), "um",
            "over 10 s with the start; the thesis does not state how long"),
        Row(SECTION, "RMS error, composite, after the first second", None,
            _rms((reference_um - composite_um)[settled]), "um"),
    ])


def estimated_model():
    """Return the hysteresis estimated from one sine, with negative densities set to zero."""
    data = one_sine()
    voltage_v = input_v(np.arange(SAMPLES) * SAMPLE_PERIOD_S)
    decomposition = truncated_svd(data.equations, rank=RANK)
    model = density_by_svd(decomposition, voltage_v, data.levels_v).model()
    density = np.maximum(model.density_um_per_v2, 0.0)
    return PreisachModel(0.0, HIGHEST_V, density)


def track(reference_um, feedforward_v, proportional, integral_per_s):
    """Return the displacement of the true hysteresis with feedforward and PI feedback."""
    truth = PreisachModel(0.0, HIGHEST_V, np.tril(np.full((LEVELS, LEVELS), DENSITY)))
    memory = truth.memory()
    displacement_um = np.empty_like(reference_um)
    integral_v, feedback_v = 0.0, 0.0
    for n, (reference, voltage_v) in enumerate(zip(reference_um, feedforward_v, strict=True)):
        displacement_um[n] = truth.simulate([voltage_v + feedback_v], memory)[0] + OFFSET_UM
        error_um = reference - displacement_um[n]
        integral_v += integral_per_s * SAMPLE_PERIOD_S * error_um
        feedback_v = proportional * error_um + integral_v
    return displacement_um


def _rms(values):
    return float(np.sqrt(np.mean(values**2)))
