# SPDX-License-Identifier: BSD-3-Clause
"""All studies, in the order of the thesis."""

from piezo_studies.thesis import (
    chirp_response,
    compensation,
    designed_hysteresis,
    excitation,
    feedback_figures,
    identified_stage,
    inverse_feedforward,
    known_density,
    known_dynamics,
    learned_tracking,
    multirate_tracking,
    multisine_dynamics,
    one_sine,
    scanning,
    slow_hysteresis,
    slow_tracking,
    stepwise_inversion,
    validation,
)

STUDIES = (
    ("a density from one sine", one_sine.study),
    ("compensation with an offset", compensation.study),
    ("slow hysteresis of the stage", slow_hysteresis.study),
    ("slow tracking by PID and composite", slow_tracking.study),
    ("hysteresis from designed samples", designed_hysteresis.study),
    ("dynamics from six sines", multisine_dynamics.study),
    ("inversion by steps", stepwise_inversion.study),
    ("scanning by PI and composite", scanning.study),
    ("creep and dynamics of a known plant", known_dynamics.study),
    ("density of a known plant", known_density.study),
    ("frequency response by a chirp", chirp_response.study),
    ("the stage step by step", identified_stage.study),
    ("the stage's model on unseen input", validation.study),
    ("inverse feedforward", inverse_feedforward.study),
    ("feedback design", feedback_figures.study),
    ("multirate and single-rate tracking", multirate_tracking.study),
    ("learned tracking", learned_tracking.study),
    ("excitation of the designed input", excitation.study),
)

CAPTIONS = {
    "2.2": "Error of the estimated density, by projection and by truncated SVD.",
    "2.3": "Error of the output on unseen input while new points are taken in.",
    "2.7": "Singular values of the normal equations of 120,000 samples, and the density.",
    "2.8": "Loop at 1 Hz, measured and modelled; actual over desired displacement with the "
           "inverse. Creep makes most of the error.",
    "2.11": "Errors at 1 Hz and 25 Hz under PID and composite control.",
    "3.5": "Drift between harmonics, the polynomial through it, and its residual.",
    "3.6": "Singular values of the normal equations of 3661 chosen samples, and the density.",
    "3.8": "Six sines, measured and modelled.",
    "3.10": "Displacement over reference in open loop and under composite control.",
    "4.9": "Known plant: loops with creep and after it was removed; the density found.",
    "4.10": "Known plant: dynamics that a chirp shows if the hysteresis is ignored.",
    "4.11": "Density of the simulated stage.",
    "4.12": "Loops of the simulated stage under inputs that were not fitted.",
    "4.14": "Sines under the inverse of the identified model, and in open loop.",
    "5.4": "Sensitivity of the feedback designs.",
    "5.6": "Error under composite control about the moment when an offset comes.",
    "5.9": "Spectra of feedforward and feedback at 500 Hz and 1 kHz.",
}
"""Captions of our figures by number of the corresponding figure in the thesis."""
