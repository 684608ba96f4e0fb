# SPDX-License-Identifier: BSD-3-Clause
"""Table 3.1 and section 5.3 with a further column: learning with a model that is 5 % off.

The figures are medians over several models with different signs of their errors and different
noise. They are errors of the true position, with the offset and drift of all closed loops here.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from piezo_controller.feedback.multirate_feedback import MultirateFeedback
from piezo_controller.learning.slow_feedback import design_integral_feedback
from piezo_controller.references.reference import Reference
from piezo_controller.tracking.run_plan import plan_learning
from piezo_controller.tracking.tracking_modes import StageClock
from piezo_controller.tracking.tracking_run import TrackingRun
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_sim.plant.plant_file import read_plant
from piezo_sim.simulated_stage import SimulatedStage
from piezo_studies.thesis.figure_table import Row, Study
from piezo_studies.thesis.laboratory import CLOCK_HZ
from piezo_studies.thesis.tracked_stage import DRIFT_UM_PER_S, OFFSET_UM

CELLS = 50


def wrong_model(part, seed):
    """Return the default plant's model with a relative error of random sign in every parameter.

    The voltage limits are exact.
    """
    generator = np.random.default_rng(seed)

    def wrong(values):
        values = np.asarray(values, dtype=float)
        return values * (1.0 + part * generator.choice([-1.0, 1.0], values.shape))

    plant = read_plant(None)
    stage: tuple[Any, ...] = plant.stage
    hysteresis, creep, lag, *modes = stage
    amplifier: Any = plant.amplifier[0]
    return StageModel(
        _hysteresis(hysteresis, amplifier.voltage_min_v, amplifier.voltage_max_v, wrong),
        CreepDynamics(tuple(wrong(creep.poles_rad_per_s)), tuple(wrong(creep.zeros_rad_per_s))),
        ElectricVibrationDynamics(
            float(wrong(lag.time_constant_s)),
            tuple(wrong([mode.frequency_rad_per_s for mode in modes])),
            tuple(wrong([mode.damping_ratio for mode in modes]))))


def _hysteresis(plant, lowest_v, highest_v, wrong):
    """Return the plant's density with wrong parameters, averaged over the cells of a grid."""
    broad, ridge, width_v, modulation, centre_v, period_v, offset_um = wrong([
        plant.broad_density_um_per_v2, plant.ridge_density_um_per_v2, plant.ridge_width_v,
        plant.position_modulation, plant.modulation_centre_v, plant.modulation_period_v,
        plant.offset_um])
    cell_v = (highest_v - lowest_v) / CELLS
    alpha_v, beta_v = lowest_v + (np.indices((CELLS, CELLS)) + 0.5) * cell_v
    span_v, middle_v = alpha_v - beta_v, (alpha_v + beta_v) / 2
    ratio = cell_v / width_v
    inside = 2 * (ratio - 1 + np.exp(-ratio)) / ratio**2  # for the triangles on the diagonal
    profile = np.where(span_v > cell_v / 2, np.exp(-span_v / width_v)
                       * (2 * np.sinh(ratio / 2) / ratio) ** 2, inside)
    crest = 1.0 + modulation * np.cos(2 * np.pi * (middle_v - centre_v) / period_v)
    return PreisachModel(lowest_v, highest_v, np.tril((broad + ridge * profile) * crest), offset_um)


SAMPLES_PER_TICK = 40
MODEL_ERROR = 0.05
SEEDS = 12
ITERATIONS = 10
DURATION_S = 0.2
CENTRE_UM = 57.0
CASES = (("3.4.4, Table 3.1", 40.0, 40.0, 0.75), ("3.4.4, Table 3.1", 100.0, 40.0, 1.21),
         ("3.4.4, Table 3.1", 600.0, 20.0, 1.76), ("5.3.2", 500.0, 21.0, 2.3),
         ("5.3.2", 1000.0, 10.25, 2.2), ("beyond", 1500.0, 0.8, None),
         ("beyond", 2000.0, 0.16, None))
"""Section, frequency (Hz), peak-to-peak amplitude (um), and e_rms (%) of the composite control in
the thesis."""

COMPARED = "thesis: composite; ours: "


@dataclass(frozen=True)
class LearnedRun:
    """The result of a learning run."""

    true_percent: float
    """Error e_rms of the true position with the best learned feedforward."""
    iterations: int

    why: str
    """Reason for the end of the learning."""


def study():
    """Learn every sine with several wrong models; return the median errors."""
    rows = []
    for section, frequency_hz, amplitude_um, thesis in CASES:
        runs = [learn(frequency_hz, amplitude_um, seed) for seed in range(SEEDS)]
        most = max(run.iterations for run in runs)
        rows.append(Row(
            section, f"e_rms at {frequency_hz:g} Hz, {amplitude_um:g} um, learning", thesis,
            np.median([run.true_percent for run in runs]), "%",
            f"{COMPARED if thesis else ''}median of {SEEDS} models {100 * MODEL_ERROR:g} % off, "
            f"at most {most} iterations"))
    return Study(rows)


def learn(frequency_hz, amplitude_um, seed):
    """Learn a harmonic of a frequency and a peak-to-peak amplitude from a wrong model on the stage.

    The seed is that of the model's errors and of the stage.
    """
    model = wrong_model(MODEL_ERROR, seed)
    controller = design_integral_feedback(model)
    reference = Reference("harmonic", (frequency_hz,), (amplitude_um,), (), CENTRE_UM)
    feedforward, learner = plan_learning(
        reference, round(DURATION_S * CLOCK_HZ), model, controller, StageClock(), ITERATIONS)
    run = TrackingRun(feedforward, round(DURATION_S * CLOCK_HZ), MultirateFeedback(controller))
    true_um = np.concatenate(list(_loop(feedforward, run, seed)))
    begin = feedforward.begin_sample
    error_um = true_um[begin:] - feedforward.expected_um(begin, true_um.size - begin)
    return LearnedRun(100 * np.sqrt(np.mean(error_um**2)) / amplitude_um, learner.iterations,
                      learner.finished)


def _loop(feedforward, run, seed):
    """Close the loop like the stage, and yield the true displacements tick by tick."""
    stage = SimulatedStage(seed=seed)
    stage.open()
    loaded_v, played, answers_v = feedforward.once_voltage_v, 0, [0.0, 0.0]
    while not run.complete:
        if loaded_v.size < played + SAMPLES_PER_TICK:
            loaded_v = np.append(loaded_v, feedforward.next_voltage_v())
        time_s = np.arange(played, played + SAMPLES_PER_TICK) / CLOCK_HZ
        disturbance_um = OFFSET_UM + DRIFT_UM_PER_S * time_s
        # The feedback computed from a tick acts in the tick after the next.
        displacement_um = disturbance_um + stage.exchange(
            loaded_v[played:played + SAMPLES_PER_TICK] + answers_v.pop(0))
        played += SAMPLES_PER_TICK
        feedforward.take(displacement_um)
        answers_v.append(run.take(displacement_um))
        yield stage.true_displacement_um + disturbance_um
