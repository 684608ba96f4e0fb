# SPDX-License-Identifier: BSD-3-Clause
"""Creep, electric and vibration dynamics, estimated from the recordings that show them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_common.budget import while_time_lasts
from piezo_common.cancellation import check_cancelled
from piezo_identification.conditioning.row_alignment import (
    SIGNIFICANT,
    is_point_by_point,
    read_as,
    reading_at_jumps,
    rows_read_at_start,
)
from piezo_identification.conditioning.settling import SlowDynamics, slow_delay_s, slow_dynamics
from piezo_identification.conditioning.waveforms import has_holds, played, square_part, two_levels
from piezo_identification.estimators.creep.slow_creep import estimate_slow_creep
from piezo_identification.estimators.creep.square_wave_creep import estimate_creep
from piezo_identification.estimators.dynamics.fast_dynamics import ModeOrder
from piezo_identification.estimators.dynamics.fast_estimate import estimate_dynamics
from piezo_identification.estimators.estimate import DECISIVE, Estimate
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.estimators.frequency_response.response_fit import (
    ANY_ORDER,
    ResponseOrder,
    estimate_from_response,
)
from piezo_identification.estimators.hysteresis.density_estimate import DensityEstimate
from piezo_identification.estimators.hysteresis.density_fit import estimate_density
from piezo_identification.fitting.evidence import (
    INDEPENDENT,
    independent_errors,
    log_evidence,
)
from piezo_identification.fitting.whole_model import BEFORE_DELAY
from piezo_identification.simulation.past_search import after_saturation
from piezo_models.cascade import StageModel
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.effects.delay import Delay
from piezo_models.effects.effect import Effect
from piezo_models.hysteresis.first_rise import FirstRise
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording

END_OF_HOLD = 1.0
"""Instant at the end of the hold of a voltage, in sample periods."""

NEAR_THE_END = 0.25
"""Distance from the end of the hold, in sample periods, within which rows count as read there."""

DRIVING_LEVELS = 30
"""Levels of a density that is only the input of a fit of the dynamics, or used to find when rows
are read. Compared with the errors of both, a finer density makes no difference."""

CLEARLY_LESS = 0.9
"""Largest ratio of the creep residuals at which its rows are read otherwise than those of the
dynamics, because slow rows hardly determine the instant."""

ONCE_MORE = 4
"""Number of orders, the best of the first pass, that the second pass compares. The input of the
dynamics changes less between the passes than the residuals of other orders differ."""

SECOND_PASS = 0.3
"""Share of the time limit after which no second pass is made."""


@dataclass(frozen=True)
class LinearDynamics:
    """Estimated linear part of the model, which follows the hysteresis, and effects."""

    creep: CreepDynamics = CreepDynamics()
    dynamics: ElectricVibrationDynamics = ElectricVibrationDynamics()

    delay_s: float = 0.0
    """Delay of the stage in addition to the dynamics."""
    effects: tuple[Effect, ...] = ()
    """Lag ahead of the hysteresis, modes in addition to those of the dynamics, and sensor lag."""
    read_at_samples: float = 0.0
    """Estimated instant at which the rows of the dynamics recording are read, in sample periods
    after their voltage."""
    creep_read_at_samples: float = 0.0
    """The same instant for the creep recording, which may come from another logger."""
    estimates: dict[str, Estimate] = field(default_factory=dict)
    """Estimates by experiment: creep, dynamics."""
    uncertainties: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Standard deviations of creep and dynamics, as far as they were estimated."""
    effect_deviations: tuple[dict[str, float], ...] = ()
    """Standard deviations of the parameters of all effects that `all_effects` returns."""

    @property
    def shared_reading(self) -> float:
        """The instant of the dynamics' rows within their hold, which slower rows may share."""
        return min(self.read_at_samples, END_OF_HOLD)

    @property
    def all_effects(self) -> tuple[Effect, ...]:
        """Effects of the model, in the order of the signal."""
        delay = (Delay(self.delay_s),) if self.delay_s else ()
        return (*(effect for effect in self.effects if effect.place in BEFORE_DELAY), *delay,
                *(effect for effect in self.effects if effect.place not in BEFORE_DELAY))

    @property
    def slow_dynamics(self) -> SlowDynamics:
        """Dynamics in effect at low frequency, with every mode that has to settle."""
        return slow_dynamics(self.dynamics, self.effects)

    @property
    def slow_delay_s(self) -> float:
        """Delay of slow signals in addition to those dynamics."""
        return slow_delay_s(self.dynamics, self.all_effects)

    def of_model(self, model: StageModel) -> "LinearDynamics":
        """Return the linear part of a fitted model, and its lags, in place of the estimates."""
        delays = [effect for effect in model.effects if type(effect) is Delay]
        return replace(
            self, creep=model.creep, dynamics=model.dynamics, effect_deviations=(),
            delay_s=sum(effect.delay_s for effect in delays),
            effects=tuple(effect for effect in model.effects
                          if not isinstance(effect, Delay | BoucWenHysteresis)))

    def with_creep(self, estimate: Estimate, read_at_samples: float) -> "LinearDynamics":
        """Return the model with the creep estimated from a recording."""
        return replace(
            self, creep=estimate.model, creep_read_at_samples=read_at_samples,
            estimates=self.estimates | {"creep": estimate},
            uncertainties=self.uncertainties | {"creep": estimate.standard_deviations},
        )

    def with_dynamics(self, estimate: Estimate) -> "LinearDynamics":
        """Return the model with the dynamics estimated from a recording, and its delay separated.

        A displacement ahead of its voltage can only come from the logger, which then reads its rows
        late. A displacement behind its voltage is attributed to a delay of the stage.
        """
        delay_s, read_at, deviations = 0.0, 0.0, list(estimate.effect_deviations)
        delay = estimate.delay
        if delay is not None and delay.is_significant:
            delay_s, read_at = max(delay.delay_s, 0.0), max(-delay.samples, 0.0)
            by_s = abs(delay.delay_s + delay.sample_period_s)
            if by_s < min(SIGNIFICANT * delay.standard_deviation_s,
                          NEAR_THE_END * delay.sample_period_s):
                # The logger is then most likely to read at the end of the hold.
                read_at = END_OF_HOLD
            if delay_s:
                before = sum(effect.place in BEFORE_DELAY for effect in estimate.effects)
                deviations.insert(before, {"delay_s": delay.standard_deviation_s})
        creep, spread = self._creep_given_dynamics(estimate.creep, estimate.creep_deviations)
        return replace(
            self, creep=creep, dynamics=estimate.model, effects=estimate.effects, delay_s=delay_s,
            read_at_samples=read_at, effect_deviations=tuple(deviations),
            estimates=self.estimates | {"dynamics": estimate},
            uncertainties=self.uncertainties | spread | {
                "dynamics": estimate.standard_deviations},
        )

    def with_response(self, estimate: Estimate) -> "LinearDynamics":
        """Return the model with the results of a frequency response added, including creep."""
        model, deviations = estimate.model, estimate.standard_deviations
        creep, spread = self._creep_given_dynamics(model.creep, deviations["creep"])
        return replace(
            self.with_dynamics(estimate), creep=creep, dynamics=model.dynamics,
            delay_s=model.delay_s, effect_deviations=estimate.effect_deviations + (
                ({"delay_s": deviations["delay_s"]},) if model.delay_s else ()),
            uncertainties=self.uncertainties | spread | {"dynamics": deviations["dynamics"]},
        )

    def _creep_given_dynamics(
        self, creep: CreepDynamics, deviations: Mapping[str, Sequence[float]],
    ) -> tuple[CreepDynamics, dict[str, dict[str, Any]]]:
        """Return known and additional creep sorted by rate, with their uncertainties."""
        if not creep.poles_rad_per_s:
            return self.creep, {}
        known_spread = self.uncertainties.get("creep", {})
        values, spread = {}, {}
        for name, known in asdict(self.creep).items():
            rates = np.append(known, getattr(creep, name))
            order = np.argsort(rates)
            values[name] = tuple(rates[order].tolist())
            spread[name] = tuple(np.append(
                known_spread.get(name, ()), deviations.get(name, ()))[order].tolist())
        return CreepDynamics(**values), {"creep": spread}


def estimate_linear_dynamics(
    creep: Sequence[Recording], dynamics: Sequence[Recording] | FrequencyResponse,
    hysteresis: Sequence[Recording],
    order: ResponseOrder = ANY_ORDER,
    begin: Callable[[str, float], object] = lambda *_: None,
) -> LinearDynamics:
    """Estimate creep, then the fast dynamics with the creep removed, and both again if needed.

    The second pass reduces the error that each causes in the other. Creep is estimated from a
    square wave between two voltages, or from any other slow recordings. Fast dynamics are estimated
    from a periodic square wave between two voltages, from any other fast recordings, or from a
    measured frequency response. For other fast recordings, the hysteresis is estimated before, or
    together with the dynamics if it was not recorded. If their sample periods differ, those with
    the shortest are used here, and all in the fit of the whole model.

    The recordings of creep and hysteresis have no gaps; an empty sequence stands for none. Raise
    ValueError if a recording does not fit its purpose.
    """
    found = LinearDynamics()
    fast = [] if isinstance(dynamics, FrequencyResponse) else of_the_fastest_clock(dynamics)
    given = isinstance(dynamics, FrequencyResponse) or len(fast) > 0
    needs_hysteresis = len(hysteresis) > 0 and not all(map(is_square_wave, fast))
    driving: DensityEstimate | None = None
    # Only loops of another speed tell creep from the hysteresis if the voltage never stands.
    slow = creep if any(has_holds(played(each)) for each in creep) else [*creep, *hysteresis]
    highest_rad_per_s = max((np.pi / part.sample_period_s for part in fast), default=0.0)

    def estimated(found: LinearDynamics, driving: DensityEstimate | None,
                  turn: int) -> tuple[LinearDynamics, DensityEstimate | None]:
        if creep:
            begin("creep, given the dynamics" if turn else "creep", 0.5 * turn)
            found = found.with_creep(*creep_of(
                slow, found, bool(turn), order.creep_pairs, highest_rad_per_s))
        if not given:
            return found, driving
        begin("dynamics, given the creep" if turn else "dynamics", 0.5 * turn + 0.3)
        if isinstance(dynamics, FrequencyResponse):
            return found.with_response(_from_response(
                dynamics, found, order, bool(hysteresis))), driving
        if needs_hysteresis:
            driving = aligned_density(hysteresis, found, driving)[0]
        density = None if driving is None else driving.model()
        estimate = estimate_dynamics(
            fast, found.creep, order.modes, among=_likely(found), hysteresis=density)
        if order.creep_pairs is not None and found.creep.poles_rad_per_s:
            # The requested number of pairs is reached; the joint fit estimates them together.
            estimate = replace(estimate, creep=CreepDynamics())
        return found.with_dynamics(estimate), driving

    found, driving = estimated(found, driving, 0)
    # A second pass has no effect if only one of them is recorded. Where loops are recorded for fast
    # motion of many voltages, the one fit of all parameters replaces it, but does not find when
    # rows are read.
    read_at = _creep_readings(slow, found) | loop_readings(hysteresis, found)
    if given and (not needs_hysteresis or read_at != {0.0}) and (creep or needs_hysteresis):
        with while_time_lasts("second estimates of creep and dynamics", SECOND_PASS):
            check_cancelled()
            found, driving = estimated(found, driving, 1)
    return found


def creep_of(
    recordings: Sequence[Recording], found: LinearDynamics, is_dynamics_known: bool,
    pair_count: int | None, highest_rad_per_s: float = 0.0,
) -> tuple[Estimate, float]:
    """Estimate the creep, with rows read as its jumps show, otherwise as those of the dynamics.

    If jumps are inconclusive, rows are read with their voltage if that reduces the residual
    clearly: a wrong shift of fast rows smears the steps of slow ones. Jumps are not used until
    there are dynamics, because a model without them responds to a jump immediately.

    The number of creep pairs is chosen from the data unless it is given. The second result is the
    instant at which the rows are read, in sample periods after their voltage.
    """
    tried = []
    for read_at in _creep_readings(recordings, found):
        aligned = [rows_read_at_start(each, read_as(each, read_at)) for each in recordings]
        estimate = _creep_of_aligned(
            aligned, found, is_dynamics_known, pair_count, highest_rad_per_s)
        is_alike = read_at == found.shared_reading
        tried.append((
            estimate.residual_rms / (1.0 if is_alike else CLEARLY_LESS), estimate, read_at))
    return min(tried, key=lambda entry: entry[0])[1:]


def _creep_readings(recordings: Sequence[Recording], found: LinearDynamics) -> set[float]:
    """Return the instant that the jumps of all recordings agree on, otherwise those to try."""
    at_jumps = [] if found.dynamics.is_static else [reading_at_jumps(each) for each in recordings]
    clear = {each for each in at_jumps if each is not None}
    return clear if len(clear) == 1 and None not in at_jumps else {
        found.shared_reading, found.read_at_samples, 0.0}


def _creep_of_aligned(
    recordings: Sequence[Recording], found: LinearDynamics, is_dynamics_known: bool,
    pair_count: int | None, highest_rad_per_s: float,
) -> Estimate:
    """Return the creep from a single square wave, or from other slow recordings."""
    dynamics = found.slow_dynamics if is_dynamics_known else None
    if len(recordings) == 1 and is_square_wave(recordings[0]):
        return estimate_creep(
            recordings[0], dynamics, pair_count, found.slow_delay_s, highest_rad_per_s)
    return estimate_slow_creep(recordings, dynamics, pair_count, highest_rad_per_s)


def loop_readings(hysteresis: Sequence[Recording], found: LinearDynamics) -> set[float]:
    """Return the instants at which rows of loops may be read, in sample periods; 0 is one.

    They may be read with their voltage, as the rows of the dynamics, or as their jumps show.
    Points of a static loop may also be read at the end of their hold, when the stage has come to
    rest. Jumps and points are not used until there are dynamics: a model without them responds
    immediately, and does not distinguish the two ends of the hold.
    """
    readings = {0.0, *(read_as(each, read_at) for each in hysteresis
                       for read_at in (found.shared_reading, found.read_at_samples))}
    if found.dynamics.is_static:
        return readings
    readings |= {reading_at_jumps(each) or 0.0 for each in hysteresis}
    return readings | {read_as(each, END_OF_HOLD) for each in hysteresis if is_point_by_point(each)}


def aligned_density(
    hysteresis: Sequence[Recording], found: LinearDynamics, before: DensityEstimate | None = None,
) -> tuple[DensityEstimate, float]:
    """Estimate the density, with its recordings read at the instant that fits them best.

    They are read with their voltage unless the evidence for another instant is decisive: the errors
    of a wrong model do not show when rows are read. The weights of an estimate with other dynamics
    are reused; without one, they are chosen. The second result is the instant at which the rows of
    the recordings are read, in sample periods after their voltage.
    """
    tried = []
    smoothing = before.smoothing_weight if before is not None else None
    for read_at in loop_readings(hysteresis, found):
        aligned = [rows_read_at_start(each, read_as(each, read_at)) for each in hysteresis]
        density = estimate_density(
            aligned, found.creep, found.slow_dynamics, smoothing_weight=smoothing,
            delay_s=found.slow_delay_s, most_levels=DRIVING_LEVELS)
        tried.append((density, read_at, aligned))
    if len(tried) == 1:
        return tried[0][:2]

    def errors_um(entry: tuple[DensityEstimate, float, list[Recording]]) -> list[FloatArray]:
        model = StageModel(entry[0].model(), found.creep, found.dynamics,
                           effects=found.all_effects)
        runs = [after_saturation(model, each) for each in entry[2]]
        return [run.without_initial_motion(run.measured_um - run.simulate()) for run in runs]

    errors = list(map(errors_um, tried))
    at_once = next(index for index, entry in enumerate(tried) if entry[1] == 0.0)
    counts = [independent_errors(each) for each in errors[at_once]]
    evidence = np.array([
        log_evidence([np.mean(each**2) for each in of_entry], 0, counts) for of_entry in errors])
    best = int(np.argmax(evidence))
    return tried[best if evidence[best] > evidence[at_once] + DECISIVE else at_once][:2]


def _from_response(
    measured: FrequencyResponse, found: LinearDynamics, order: ResponseOrder, has_loss: bool,
) -> Estimate:
    """Fit a response with or, unless the stage is known to have hysteresis, without its loss."""
    if "creep" in found.estimates:
        measured = replace(measured, gain=measured.gain / found.creep.response(
            measured.frequency_hz))
        # The requested number of pairs is already in the creep of the recording.
        order = order if order.creep_pairs is None else replace(order, creep_pairs=0)
    lossy = estimate_from_response(measured, order, has_loss=True)
    if has_loss:
        return lossy
    lossless = estimate_from_response(measured, order)
    independent = min(2.0 * measured.frequency_hz.size, INDEPENDENT)
    with_loss, without = (log_evidence(
        each.residual_rms**2, each.chosen.parameters, independent) for each in (lossy, lossless))
    return lossy if with_loss > without + DECISIVE else lossless


def _likely(found: LinearDynamics) -> list[ModeOrder]:
    """Return the best orders of the dynamics in the first pass; empty if there was none."""
    if "dynamics" not in found.estimates:
        return []
    trials = sorted(found.estimates["dynamics"].trials, key=lambda trial: trial.information)
    return [trial.order for trial in trials[:ONCE_MORE]]


def of_the_fastest_clock(recordings: Sequence[Recording]) -> list[Recording]:
    """Return the recordings with the shortest sample period, which show the highest modes."""
    shortest_s = min((each.sample_period_s for each in recordings), default=0.0)
    return [each for each in recordings if np.isclose(each.sample_period_s, shortest_s, 1e-6, 0.0)]


def is_square_wave(recording: Recording) -> bool:
    """Return whether the voltage of a recording has two levels."""
    return two_levels(square_part(played(recording))) is not None


@dataclass(frozen=True)
class FittedModel:
    """A model with the standard deviations of its parameters, before its errors are measured."""

    model: StageModel

    uncertainties: dict[str, Any]
    """Standard deviations of creep and dynamics, as far as they were estimated."""
    visited: NDArray[np.bool_]
    """Cells of the Preisach plane that the data determine, (n, n)."""


def fitted_model(linear: LinearDynamics, density: DensityEstimate,
                 first_rise: FirstRise | None = None) -> FittedModel:
    """Assemble the estimated components; further parts of the dynamics become effects."""
    model = StageModel(
        density.model(), linear.creep, linear.dynamics, effects=linear.all_effects,
        first_rise=first_rise,
    )
    uncertainties: dict[str, Any] = dict(linear.uncertainties)
    if linear.all_effects:
        uncertainties["effects"] = list(linear.effect_deviations)
    return FittedModel(model, uncertainties, density.visited)
