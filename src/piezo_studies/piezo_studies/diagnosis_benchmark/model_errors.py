# SPDX-License-Identifier: BSD-3-Clause
"""The errors of models without missing effects on recordings that were not fitted.

They determine `ErrorSettings.carried_spread` of the diagnosis.
"""

import argparse

import numpy as np

from piezo_identification.diagnosis.report.diagnosis_results import stated_error_um
from piezo_identification.fitting.dataset import simulate_recordings
from piezo_identification.fitting.regression import first_regression
from piezo_studies.diagnosis_benchmark import records
from piezo_studies.diagnosis_benchmark.cases import Case
from piezo_studies.diagnosis_benchmark.plants import draw_plant, noise_um
from piezo_studies.diagnosis_benchmark.run_case import clean_model
from piezo_studies.diagnosis_benchmark.short_case import KINDS, PLANTS, waveform


def errors_over_stated(seed, plant, identified):
    """Return the errors of a model on clean recordings over the error that its file states.

    The errors, (n,), are the RMS beyond the noise on held-out stretches, for each kind of waveform
    at each rate.
    """
    stage, ratios = draw_plant((seed, plant)), []
    for is_slow in (False, True):
        for number, kind in enumerate(KINDS):
            case = Case(number, seed, plant, (), (), kind, is_slow, later=True)
            recording = records.record(stage, waveform(case), number)
            regression = first_regression(simulate_recordings(identified.model, [recording]))
            residual_um = regression.residual_um(regression.fit(()))
            ratios.append(np.sqrt(max(0.0, residual_um**2 - noise_um(stage)**2)))
    return np.array(ratios) / stated_error_um(identified)


def sentence(ratios):
    """Return a sentence on the error ratios of several models."""
    low, middle, high = np.quantile(ratios, (0.1, 0.5, 0.9))
    return (f"in {ratios.size} recordings the models are wrong by {middle:.2f} times what their "
            f"files state (median; 10 % below {low:.2f}, 10 % above {high:.2f}, at most "
            f"{ratios.max():.2f})")


def main(arguments=None):
    """Print the errors of the models of drawn plants over those that their files state."""
    parser = argparse.ArgumentParser(prog="model_errors", description=main.__doc__)
    parser.add_argument("--seed", type=int, default=523, help="of everything random (%(default)s)")
    seed = parser.parse_args(arguments).seed
    print(sentence(np.concatenate([
        errors_over_stated(seed, plant, clean_model(seed, plant)[0]) for plant in range(PLANTS)])))


if __name__ == "__main__":
    main()
