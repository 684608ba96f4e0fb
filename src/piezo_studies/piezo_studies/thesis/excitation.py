# SPDX-License-Identifier: BSD-3-Clause
"""Appendix A.2: ten densities are identifiable with the designed input, seven with usual inputs."""

import numpy as np

from piezo_identification.experiments.input_designs import stair_amplitudes, stair_harmonics
from piezo_studies.baselines.relay_regression import excitation_rank
from piezo_studies.baselines.sampling_rules import stair_sample_times
from piezo_studies.thesis.figure_table import Row, Study

LEVELS = 4
HIGHEST_V = 4.0
HARMONIC_PERIOD_S = 2.0
SECTION = "A.2"


def study():
    """Compute the rank of the regression for three inputs."""
    levels_v = np.linspace(0.0, HIGHEST_V, LEVELS + 1)
    amplitudes_v = stair_amplitudes(LEVELS, HIGHEST_V)
    sampled_s = stair_sample_times(amplitudes_v, HARMONIC_PERIOD_S, levels_v[1:])
    designed_v = stair_harmonics(sampled_s, amplitudes_v, HARMONIC_PERIOD_S)
    time_s = np.arange(800) * 0.01
    phases = {
        "one frequency": np.pi * time_s,
        "several frequencies": np.pi * time_s * (0.5 + time_s / time_s[-1]),
    }
    return Study([
        Row(SECTION, "rank, designed input and sampling", 10,
            excitation_rank(designed_v, levels_v), "1"),
        *(Row(SECTION, f"rank, constant amplitude, {name}", 7,
              excitation_rank(0.5 * HIGHEST_V * (1.0 - np.cos(phase)), levels_v), "1")
          for name, phase in phases.items()),
    ])
