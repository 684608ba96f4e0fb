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
    unseen_inputs,
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
    ("the stage's model on unseen input", unseen_inputs.study),
    ("inverse feedforward", inverse_feedforward.study),
    ("feedback design", feedback_figures.study),
    ("multirate and single-rate tracking", multirate_tracking.study),
    ("learned tracking", learned_tracking.study),
    ("excitation of the designed input", excitation.study),
)
