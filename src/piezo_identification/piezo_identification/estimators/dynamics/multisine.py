# SPDX-License-Identifier: BSD-3-Clause
"""Electric and vibration dynamics from a multi-sine and an identified hysteresis (thesis 3.4.2)."""

import numpy as np

from piezo_identification.conditioning.waveforms import slow_branches
from piezo_identification.estimators.dynamics.fast_signals import (
    FEWEST_SAMPLES,
    FastSignals,
    fit_signals,
    joined_signals,
    played_at_the_clock,
    through_hysteresis,
)
from piezo_identification.estimators.dynamics.square_wave import WARM_UP_S
from piezo_identification.estimators.estimate import Estimate
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics
from piezo_recorder.reading.recording import Recording


def estimate_dynamics_multisine(
    recording: Recording, hysteresis: PreisachModel, creep: CreepDynamics,
    mode_count: int | None = None, delay: float | None = None,
) -> Estimate:
    """Estimate the electric lag and the vibration modes (3.2) from a multi-sine.

    The identified hysteresis determines the input of the dynamics. The inverse response at the
    excited lines is a polynomial in the frequency, which gives initial values; the physical
    parameters are then fitted for the least output error.

    Parameters
    ----------
    recording : Recording
        Recording of the multisine experiment at the full sample clock: any fast input that starts
        from negative saturation.
    hysteresis : PreisachModel
        Hysteresis that covers the voltages of the recording.
    mode_count : int, optional
        By default as many as the Bayesian information criterion justifies.
    delay : float, optional
        Delay of the rows in sample periods; by default it is estimated.

    Returns
    -------
    Estimate
        Its model is an `ElectricVibrationDynamics`; its order counts modes. The standard
        deviations assume exact hysteresis and creep.

    Raises
    ------
    ValueError
        If the recording has gaps, is averaged, leaves the hysteresis' range, or is too short.

    Examples
    --------
    >>> import numpy as np
    >>> from piezo_models import (
    ...     CreepDynamics, ElectricVibrationDynamics, PreisachModel, StageModel)
    >>> from piezo_recorder import recording_of
    >>> line = PreisachModel.line(0.0, 10.0, 2.0)
    >>> mode = ElectricVibrationDynamics(0.0, (1000.0,), (0.02,))
    >>> stage = StageModel(line, CreepDynamics(), mode)
    >>> time_s = 1e-4 * np.arange(6000)
    >>> voltage_v = 5.0 - 5.0 * np.cos(314.0 * time_s ** 2)
    >>> estimate = estimate_dynamics_multisine(recording_of({
    ...     "time_s": time_s, "voltage_v": voltage_v,
    ...     "displacement_um": stage.simulate(voltage_v, 1e-4)}),
    ...     line, CreepDynamics(), mode_count=1)
    >>> print(np.round(estimate.model.mode_frequencies_rad_per_s))
    [1000.]
    """
    return fit_signals(
        hysteresis_and_displacement(recording, hysteresis, creep), mode_count, delay)


def hysteresis_and_displacement(
    recording: Recording, hysteresis: PreisachModel, creep: CreepDynamics,
) -> FastSignals:
    """Input and output of the electric and vibration dynamics in a recording.

    Raises
    ------
    ValueError
        If the recording has gaps, is averaged, leaves the hysteresis' range, or is too short.
    """
    part = played_at_the_clock(recording)
    entering_um = through_hysteresis(recording, part, hysteresis)
    slow = np.flatnonzero(slow_branches(part.time_s, part.voltage_v))
    begin = max(slow[-1] + 1 if slow.size else 0, round(WARM_UP_S / part.sample_period_s))
    if part.voltage_v.size - begin < FEWEST_SAMPLES:
        raise ValueError(
            f"{recording.path} has no fast input after {begin * part.sample_period_s:.3g} s: give "
            "the recording of a multisine experiment"
        )
    return joined_signals([part], [entering_um], [begin], creep)
