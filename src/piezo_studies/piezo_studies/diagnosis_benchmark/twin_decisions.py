# SPDX-License-Identifier: BSD-3-Clause
"""Decide between effects that resemble each other with one proposed recording."""

import argparse

import numpy as np

from piezo_identification.diagnosis.experiment_design.decide import decide
from piezo_identification.diagnosis.joint.identification_recordings import IdentificationRecordings
from piezo_studies.diagnosis_benchmark import records
from piezo_studies.diagnosis_benchmark.effect_draws import draw_effect
from piezo_studies.diagnosis_benchmark.plants import draw_plant
from piezo_studies.diagnosis_benchmark.run_case import clean_model

TWINS = {"delay": False, "sensor_lag": False, "creep": True, "thermal_drift": True,
         "slew_limit": False, "vibration_mode": False, "stiffening": False,
         "sensor_nonlinearity": False}
"""Effects that resemble another one, and whether they need a slow logger."""

ORDER = ("delay", "sensor_lag", "stiffening", "sensor_nonlinearity", "creep", "thermal_drift",
         "vibration_mode", "slew_limit")
"""Order of the effects in `main`; the number of each is its seed."""
OVER_NOISE = 6.0
"""Contribution to the first recording over the noise: clear, but not dominant."""


def decide_twin(cause, clean, plant_seed, seed, budget=1):
    """Record a plant with one of `TWINS` in typical operation, and decide by proposed recordings.

    `clean` is the result of `run_case.clean_model`.
    """
    plant = draw_plant(plant_seed)
    experiment = records.tracking(np.random.default_rng(seed), TWINS[cause])
    voltage_v, _ = records.commanded(experiment)
    drawn = draw_effect(cause, plant, voltage_v, records.surroundings(experiment, seed), OVER_NOISE,
                        seed, records.clock_samples(experiment))
    identified, identified_from = clean
    first = records.record(drawn.plant, experiment, seed)
    steps = decide(identified.model, [first], records.player_of_proposals(drawn.plant, seed),
                   budget, records.STAGE_LIMITS,
                   identified_from=IdentificationRecordings(identified_from, ()))
    return {"cause": cause, "steps": [
        {"verdict": step.diagnosis.verdict,
         "effects": [entry["name"] for entry in step.diagnosis.effects],
         "not_decidable": sorted(step.diagnosis.not_decidable),
         "probabilities": step.probabilities, "is_decided": step.is_decided,
         "proposed": None if step.proposal is None else step.proposal.document()}
        for step in steps]}


def main(arguments=None):
    """Decide one case of each effect, and print the steps."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--seed", type=int, default=91)
    parser.add_argument("--budget", type=int, default=1)
    options = parser.parse_args(arguments)
    clean = clean_model(options.seed, 0)
    for number, cause in enumerate(ORDER, start=1):
        decision = decide_twin(cause, clean, (options.seed, 0), number, options.budget)
        print(cause)
        for step in decision["steps"]:
            chances = ", ".join(f"{name} {share:.3f}"
                                for name, share in step["probabilities"].items())
            played = step["proposed"] and (
                f"; then {step['proposed']['waveform']}, expected to decide with "
                f"{step['proposed']['probability_of_deciding']:.3f}")
            print(f"  {chances}{' (decided)' if step['is_decided'] else ''}{played or ''}",
                  flush=True)


if __name__ == "__main__":
    main()
