# SPDX-License-Identifier: BSD-3-Clause
"""Creep, electric and vibration dynamics, from whatever was recorded to show them."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from piezo_identification.conditioning.recording_start import square_part
from piezo_identification.conditioning.waveforms import played, square_wave
from piezo_identification.estimators.creep import estimate_creep
from piezo_identification.estimators.dynamics.armax_dynamics import estimate_dynamics_armax
from piezo_identification.estimators.dynamics.multisine import estimate_dynamics_multisine
from piezo_identification.estimators.dynamics.square_wave import estimate_dynamics
from piezo_identification.estimators.estimate import Estimate
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.estimators.frequency_response.response_fit import (
    ANY_ORDER,
    ResponseOrder,
    estimate_from_response,
)
from piezo_identification.estimators.hysteresis.density_fit import estimate_density
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording

METHODS = ("output-error", "armax")
"""Each estimates electric and vibration dynamics from samples."""

SIGNIFICANT = 3.0
"""Standard deviations by which a delay has to differ from none."""


@dataclass(frozen=True)
class LinearDynamics:
    """What was found behind the hysteresis.

    Parameters
    ----------
    creep : CreepDynamics
    dynamics : ElectricVibrationDynamics
    delay_s : float
        Beside the dynamics; only a frequency response tells it.
    estimates : dict of str to Estimate
        By what they were made from: creep, dynamics.
    uncertainties : dict of str to dict
        Standard deviations of creep and dynamics, as far as they were estimated.
    """

    creep: CreepDynamics = CreepDynamics()
    dynamics: ElectricVibrationDynamics = ElectricVibrationDynamics()
    delay_s: float = 0.0
    estimates: dict = field(default_factory=dict)
    uncertainties: dict = field(default_factory=dict)

    def with_creep(self, estimate: Estimate) -> "LinearDynamics":
        """Estimate the model anew with the creep of a recording."""
        return replace(
            self, creep=estimate.model, estimates=self.estimates | {"creep": estimate},
            uncertainties=self.uncertainties | {"creep": estimate.standard_deviations},
        )

    def with_dynamics(self, estimate: Estimate) -> "LinearDynamics":
        """Estimate the model anew with the dynamics of a recording."""
        return replace(
            self, dynamics=estimate.model, estimates=self.estimates | {"dynamics": estimate},
            uncertainties=self.uncertainties | {"dynamics": estimate.standard_deviations},
        )

    def with_response(self, estimate: Estimate) -> "LinearDynamics":
        """Add what a frequency response shows; its creep is that beside the known one."""
        model, deviations = estimate.model, estimate.standard_deviations
        creep, spread = {}, {}
        for name, known in asdict(self.creep).items():
            rates = np.append(known, getattr(model.creep, name))
            order = np.argsort(rates)
            creep[name] = tuple(rates[order].tolist())
            known_spread = self.uncertainties.get("creep", {}).get(name, ())
            spread[name] = tuple(
                np.append(known_spread, deviations["creep"][name])[order].tolist())
        return replace(
            self.with_dynamics(estimate), creep=CreepDynamics(**creep), dynamics=model.dynamics,
            delay_s=model.delay_s if model.delay_s > SIGNIFICANT * deviations["delay_s"] else 0.0,
            uncertainties={"creep": spread, "dynamics": deviations["dynamics"]},
        )


def estimate_linear_dynamics(
    creep: Recording | None, dynamics: Recording | FrequencyResponse | None, hysteresis: Recording,
    method: str = METHODS[0], order: ResponseOrder = ANY_ORDER,
    begin: Callable[[str, float], object] = lambda *_: None,
) -> LinearDynamics:
    """Estimate creep, then the fast dynamics with the creep removed; both once more.

    The second time, each is a smaller error to the other. Fast dynamics come from a square wave
    between two voltages; from any other fast recording, such as a multisine, for which the
    hysteresis is estimated before; or from a measured frequency response.

    Parameters
    ----------
    creep : Recording or None
    dynamics : Recording, FrequencyResponse or None
    hysteresis : Recording
    method : str
        One of `METHODS`; a frequency response has its own.
    order : ResponseOrder
        Numbers asked for.
    begin : callable
        Called with (stage, fraction of this work) before each.

    Returns
    -------
    LinearDynamics

    Raises
    ------
    ValueError
        If a recording does not fit its purpose.
    """
    found = LinearDynamics()
    needs_hysteresis = (
        dynamics is not None and not isinstance(dynamics, FrequencyResponse)
        and not _is_square_wave(dynamics)
    )
    # Where only one is recorded, there is nothing to go through twice.
    passes = 2 if dynamics is not None and (creep is not None or needs_hysteresis) else 1
    for turn in range(passes):
        if creep is not None:
            begin("creep beside the dynamics" if turn else "creep", 0.5 * turn)
            found = found.with_creep(
                estimate_creep(creep, found.dynamics if turn else None, order.creep_pairs))
        if dynamics is None:
            continue
        begin("dynamics beside the creep" if turn else "dynamics", 0.5 * turn + 0.3)
        if isinstance(dynamics, FrequencyResponse):
            found = found.with_response(_from_response(dynamics, found, order))
            continue
        density = None
        if needs_hysteresis:
            density = estimate_density(hysteresis, found.creep, found.dynamics).model()
        found = found.with_dynamics(_from_samples(dynamics, found.creep, density, method, order))
    return found


def _from_response(
    measured: FrequencyResponse, found: LinearDynamics, order: ResponseOrder,
) -> Estimate:
    if "creep" in found.estimates:
        measured = replace(measured, gain=measured.gain / found.creep.response(
            measured.frequency_hz))
        # A number that was asked for is that of the recording.
        order = order if order.creep_pairs is None else replace(order, creep_pairs=0)
    return estimate_from_response(measured, order)


def _from_samples(
    recording: Recording, creep: CreepDynamics, density: PreisachModel | None, method: str,
    order: ResponseOrder,
) -> Estimate:
    if method == "armax":
        return estimate_dynamics_armax(recording, creep, density, mode_count=order.modes)
    if density is None:
        return estimate_dynamics(recording, creep, order.modes)
    return estimate_dynamics_multisine(recording, density, creep, order.modes)


def _is_square_wave(recording: Recording) -> bool:
    part = square_part(played(recording))
    try:
        return square_wave(part).steps.size > 0
    except ValueError:
        return False
