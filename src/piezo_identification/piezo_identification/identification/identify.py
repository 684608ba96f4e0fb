# SPDX-License-Identifier: BSD-3-Clause
"""Identify a stage model from recordings, by a sequence of estimators and a joint fit.

recordings -> conditioned -> linear dynamics -> hysteresis -> model (-> without hum, again) -> one
fit of all -> errors -> adequacy -> result
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from piezo_common.budget import Budget, spending, while_time_lasts
from piezo_common.cancellation import checking
from piezo_identification.adequacy.component_adequacy import (
    ADEQUATE,
    INADEQUATE,
    adequacy_document,
    adequacy_of,
    overall_verdict,
    unseen_errors_beyond_noise,
)
from piezo_identification.adequacy.loop_shape import refuse_impossible_loops
from piezo_identification.adequacy.model_plausibility import implausible_data, implausible_model
from piezo_identification.conditioning.row_alignment import RowDelay
from piezo_identification.conditioning.segments import Recordings, experiment_of
from piezo_identification.conditioning.waveforms import played, turns_inside
from piezo_identification.estimators.estimate import unidentified_parameters
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.estimators.frequency_response.response_hold import of_the_stage
from piezo_identification.estimators.frequency_response.response_model import (
    ANY_ORDER,
    ResponseModel,
    ResponseOrder,
)
from piezo_identification.estimators.hysteresis.density_estimate import DensityEstimate
from piezo_identification.fitting.measured_response import best_gain
from piezo_identification.identification.estimated_loops import (
    CHOSEN_BY_DATA,
    DensityOptions,
    estimate_loops,
    loops_with_first_rise,
    new_loops,
)
from piezo_identification.identification.first_runs import without_first_runs
from piezo_identification.identification.given_data import (
    Data,
    aligned,
    conditioned_data,
    given_data,
    of_kind,
    with_straight_voltages,
)
from piezo_identification.identification.linear_dynamics import (
    SECOND_PASS,
    FittedModel,
    LinearDynamics,
    estimate_linear_dynamics,
    fitted_model,
)
from piezo_identification.identification.notes import Detail, Implausible
from piezo_identification.identification.one_fit import (
    FittedTogether,
    fitted_together,
    reliable,
)
from piezo_identification.identification.progress import IdentificationCancelled, Stages
from piezo_identification.identification.recorded_hum import hum_of_each, without_hum
from piezo_identification.identification.row_delays import (
    delays_of_rows_s,
    found_readings,
    report_row_delays,
    row_delays,
    validation_as_read,
)
from piezo_identification.prediction.prediction_errors import unseen_errors
from piezo_identification.recording_check.check import RecordingCheck
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.first_rise import FirstRise
from piezo_models.identified_model import IdentifiedModel
from piezo_recorder.reading.reader import origin_of
from piezo_recorder.reading.recording import Recording

__all__ = ["IdentificationCancelled", "identify"]

OUTPUT_ERROR = "output-error"

LEAST_LOSS_DEGREES = 0.1
"""Smallest angle of a response behind hysteresis that is reported."""


def identify(
    creep: Recordings | None = None,
    dynamics: Recordings | FrequencyResponse | None = None,
    hysteresis: Recordings | None = None,
    validation: Recording | None = None,
    progress: Callable[[str, float], object] | None = None,
    cancelled: Callable[[], bool] | None = None,
    refine: bool = False,
    method: str = OUTPUT_ERROR,
    order: ResponseOrder = ANY_ORDER,
    note: Callable[[str], object] | None = None,
    density: DensityOptions = CHOSEN_BY_DATA,
    read_at_samples: float = 0.0, budget: Budget | None = None,
) -> IdentifiedModel:
    """Identify a stage model from recordings (thesis 4.5).

    First the creep is estimated, then the fast dynamics with the creep removed. Both are estimated
    again, because each was disturbed by the other, unless the last fit is sure to correct that.
    The hysteresis follows with both removed. Mains hum is then subtracted from recordings that have
    it, and these steps are repeated.
    Finally, all parameters are fitted together. Components that no recording shows are omitted: the
    model then has no creep, or static dynamics. Without a recording of the hysteresis, it is
    estimated from the others; from a frequency response or a two-level voltage it is a line.

    If the displacement falls when the voltage rises, the sensor has the opposite direction: the
    signs of all displacements are changed, and the displacement of the model rises with the
    voltage.

    Parameters
    ----------
    creep : Recording or sequence of Recording, optional
        Recording of the creep experiment, or of any slow voltage.
    dynamics : Recording, sequence of Recording or FrequencyResponse, optional
        Recording of the dynamics experiment or of any fast voltage, or a measured frequency
        response. A response also provides the creep if `creep` is not given, and the delay.
    hysteresis : Recording or sequence of Recording, optional
        Recording of the hysteresis experiment, or of any other loops.
    validation : Recording, optional
        Any other recording, on which the errors are measured.
    progress : callable, optional
        Called with (stage, fraction) when a stage begins, and with ("done", 1.0) at the end.
    cancelled : callable, optional
        Called repeatedly; the identification ends when it returns True.
    refine : bool
        Has no effect: the last step always fits the whole model to all recordings except the
        validation.
    method : str
        Has no effect: the dynamics are always fitted by their output error.
    order : ResponseOrder
        Orders of creep and vibration; open ones are chosen from the data.
    note : callable, optional
        Called with text for the user. Reasons for choices, such as the orders, are of the type
        `Detail`.
    density : DensityOptions
        Grid and smoothing of the hysteresis; open options are chosen from the data.
    read_at_samples : float
        Instant at which the logger reads the displacement of a row, in sample periods after the
        row's voltage changes: 0 for the start of the hold, 1 for its end. Rows that are read later
        than this are detected from the dynamics; any other delay is attributed to the stage.
    budget : Budget, optional
        Time limit. When it is reached, searches return the best result so far, and
        `Budget.sentence` lists what was not tried. The separate steps take some time in any case.
        Ctrl-C during a search or the joint fit has the same effect.

    Raises
    ------
    ValueError
        If a recording does not fit its purpose, or none is given.
    IdentificationCancelled
        If `cancelled` returns True.

    Examples
    --------
    >>> import numpy as np
    >>> from piezo_recorder import recording_of
    >>> time_s = 0.01 * np.arange(500)
    >>> voltage_v = 5.0 - 5.0 * np.cos(6.3 * time_s)
    >>> identified = identify(hysteresis=recording_of({
    ...     "time_s": time_s, "voltage_v": voltage_v, "displacement_um": 2.0 * voltage_v}))
    >>> print(np.round(identified.model.simulate([0.0, 5.0, 10.0], 0.01), 3))
    [ 0. 10. 20.]
    """
    given = given_data(creep, dynamics, hysteresis, validation)
    stages, note = Stages(progress, cancelled), note or (lambda text: None)
    budget = budget or Budget()
    with checking(stages.check), spending(budget), stages.failures_explained(
            data.path for data in given.values()):
        if refine or method != OUTPUT_ERROR:
            note("refine and method have no effect: identify always fits all components together "
                 "at the end, by their output error")
        conditioned = conditioned_data(given, note, read_at_samples)
        report_implausible(implausible_data(given), note)
        steps = _step_by_step(conditioned, order, density, stages, 0.0, 0.15)
        humming = hum_of_each(
            conditioned, steps.fitted.model, delays_of_rows_s(conditioned, steps.read_at))
        if humming:
            for name, hum in humming.items():
                note(f"{name}: {hum.sentence}")
            conditioned = without_hum(conditioned, humming)
            with while_time_lasts("the separate steps without the hum", SECOND_PASS):
                steps = _step_by_step(conditioned, order, density, stages, 0.2, 0.05)
        report_estimates(steps.linear, steps.estimate, note)
        report_single_loop(of_kind(steps.recordings, "hysteresis"), steps.estimate, note)
        steps, together = _fitted_with_or_without_first_rise(
            steps, conditioned, order, density, stages, note)
        fitted, read_at, linear = together.fitted, together.read_at, steps.linear
        report_starts(steps.recordings, steps.cycled, linear, steps.first_rise, note)
        conditioned = with_straight_voltages(conditioned, together.straight)
        recordings, read_at = validation_as_read(
            fitted.model, conditioned, aligned(conditioned, read_at), read_at,
            bool(together.straight))
        rows = row_delays(fitted.model, recordings, read_at, read_at_samples, linear,
                          together.straight)
        report_row_delays(rows, note)
        report_loss(fitted.model, dynamics, note)
        report_uncertain_parameters(fitted, note)
        report_implausible(implausible_model(fitted.model, recordings), note)
        stages.begin("validation", 0.95)
        errors = validation_errors(fitted.model, recordings)
        delays_s = delays_of_rows_s(conditioned, read_at)
        adequacy = adequacy_document(adequacy_of(fitted.model, conditioned, delays_s, [
            name for name, number in (("creep", order.creep_pairs), ("dynamics", order.modes))
            if number is not None]))
        if any(each["verdict"] == INADEQUATE and experiment_of(name) == "hysteresis"
               for name, each in adequacy.items()):
            report_implausible(steps.impossible, note)
        if overall_verdict(adequacy) == ADEQUATE:
            report_implausible(
                unseen_errors_beyond_noise(fitted.model, conditioned, delays_s), note)
        identified = replace(
            identified_model(fitted, errors, given, rows), adequacy=adequacy,
            uncertainties=reliable(fitted.uncertainties, adequacy,
                                   isinstance(dynamics, FrequencyResponse)),
            unfinished=budget.sentence())
        stages.begin("done", 1.0)
    return identified


@dataclass(frozen=True, eq=False)
class _Steps:
    """Results of the separate steps."""

    linear: LinearDynamics
    read_at: dict[str, float]
    """When the rows of each recording are read; see `found_readings`."""
    recordings: dict[str, Data]
    """Aligned recordings."""
    impossible: list[str]
    """Why loops are implausible behind this creep and these dynamics."""
    estimate: DensityEstimate
    first_rise: FirstRise | None
    cycled: Mapping[str, Data]
    """Density, first rise, and recordings, as returned by `estimate_loops`."""

    @property
    def fitted(self) -> FittedModel:
        """The model of the separate steps."""
        return fitted_model(self.linear, self.estimate, self.first_rise)


def _fitted_with_or_without_first_rise(
    steps: _Steps, conditioned: Mapping[str, Data], order: ResponseOrder, density: DensityOptions,
    stages: Stages, note: Callable[[str], object],
) -> tuple[_Steps, FittedTogether]:
    """Fit the whole model, and again with a first rise that loops behind its dynamics seem to show.

    The separate steps recognise a first rise only if their creep and dynamics are nearly right. The
    better fit is returned, with the steps that it began with.
    """
    notes, other_notes = list[str](), list[str]()
    together = _fitted(steps, conditioned, order, density, stages.part(0.3, 0.55), notes.append)
    rival = together.fit
    if steps.first_rise is None and rival is not None and not together.is_at_noise:
        with while_time_lasts("a first rise, given the fit"):
            recordings = aligned(conditioned, together.read_at)
            linear = steps.linear.of_model(together.fitted.model)
            found = loops_with_first_rise(recordings, linear, density)
            if found is not None:
                rising = _Steps(linear, together.read_at, recordings, steps.impossible, *found)
                other = _fitted(rising, conditioned, order, density, stages.part(0.85, 0.1),
                                other_notes.append)
                # The last fits have no held-out rows that could contradict the evidence.
                if other.fit is not None and other.fit.evidence_over(rival) > 0.0:
                    steps, together, notes = rising, other, other_notes
    for text in notes:
        note(text)
    return steps, together


def _fitted(
    steps: _Steps, conditioned: Mapping[str, Data], order: ResponseOrder, density: DensityOptions,
    report: Callable[[str, float], object], note: Callable[[str], object],
) -> FittedTogether:
    """Fit the whole model from the results of the separate steps."""
    renews_loops = (of_kind(conditioned, "hysteresis") and steps.linear.estimates
                    and steps.first_rise is None)
    return fitted_together(
        steps.fitted,
        conditioned if steps.first_rise else without_first_runs(
            conditioned, steps.linear, steps.fitted.model.hysteresis),
        steps.read_at,
        partial(new_loops, conditioned, density) if renews_loops else None,
        order, report, note)


def _step_by_step(conditioned: Mapping[str, Data], order: ResponseOrder, density: DensityOptions,
                  stages: Stages, begin: float, share: float) -> _Steps:
    """Estimate creep, dynamics and hysteresis one after the other; see `Stages.part`."""
    fast = of_kind(conditioned, "dynamics")
    linear = estimate_linear_dynamics(
        of_kind(conditioned, "creep"),
        fast[0] if fast and isinstance(fast[0], FrequencyResponse) else fast,
        of_kind(conditioned, "hysteresis"), order, stages.part(begin, share))
    stages.begin("hysteresis", begin + share)
    read_at = found_readings(conditioned, linear)
    recordings = aligned(conditioned, read_at)
    impossible = [text for loops in of_kind(recordings, "hysteresis")
                  for text in refuse_impossible_loops(
                      loops, linear.creep, linear.slow_dynamics, linear.slow_delay_s)]
    return _Steps(linear, read_at, recordings, impossible,
                  *estimate_loops(recordings, linear, density))


def report_estimates(linear: LinearDynamics, density: DensityEstimate,
                     note: Callable[[str], object]) -> None:
    """Report why the orders were chosen, and which part of the Preisach plane is determined."""
    for name, estimate in linear.estimates.items():
        note(Detail(f"order of the {name}:\n{estimate.order_table()}", estimate.plot))
        if estimate.refusal:
            report_implausible([
                f"every order of the {name} that was tried has {estimate.refusal}, or another "
                "fault: check that all recordings are of the same stage and in the same units"],
                note)
        if estimate.delay is not None:
            note(Detail(f"delay of the {name}: {estimate.delay}"))
        if isinstance(estimate.model, ResponseModel) and estimate.model.gain < 0.0:
            note(f"the displacement falls as the voltage rises: the sign of the {name} is changed")
    report = f"hysteresis: {density.report()}"
    note(report if density.is_line else Detail(report))


def report_single_loop(loops: Sequence[Recording], density: DensityEstimate,
                       note: Callable[[str], object]) -> None:
    """Report that loops of other sizes are a continuation, if the voltage runs a single loop."""
    voltages_v = [played(each).voltage_v for each in loops]
    if density.is_line or not loops or turns_inside(voltages_v):
        return
    note(f"the voltage of {' and '.join(each.path for each in loops)} turns at the ends of its "
         "range only: smaller loops of the model are a continuation of this loop, and may be far "
         "off; add loops of several sizes to --hysteresis")


def report_starts(recordings: Mapping[str, Data], cycled: Mapping[str, Data],
                  linear: LinearDynamics, first_rise: FirstRise | None,
                  note: Callable[[str], object]) -> None:
    """Report the initial state of each recording, and how it is handled.

    The `cycled` recordings are those as if the stage had been cycled before each of them.
    """
    for name, data in recordings.items():
        if isinstance(data, FrequencyResponse):
            continue
        part = played(data)
        words = [f"begins at {part.voltage_v[0]:.4g} V", RecordingCheck(part).start]
        if name in linear.estimates and linear.estimates[name].start:
            words.append(linear.estimates[name].start)
        if first_rise is not None and cycled[name] is not data:
            words.append(
                f"on a stage that was never cycled: its first rise has {first_rise.whole_um:.3g}"
                " um that never return, which the model describes separately")
        note(Detail(f"start of the {name}: {'; '.join(words)}"))


def report_loss(model: StageModel, dynamics: Recordings | FrequencyResponse | None,
                note: Callable[[str], object]) -> None:
    """Report the angle of a response that a model without hysteresis leaves out."""
    if model.has_hysteresis or not isinstance(dynamics, FrequencyResponse):
        return
    measured = of_the_stage(dynamics, model)
    angle = np.degrees(np.angle(best_gain(
        model.small_signal_response(measured.frequency_hz), measured.gain)))
    if angle < -LEAST_LOSS_DEGREES:
        note(f"the response lags by {-angle:.2g} degrees at all frequencies, as small sines behind "
             "hysteresis do; the model leaves this out: give --hysteresis, too")


def report_implausible(found: Sequence[str], note: Callable[[str], object]) -> None:
    """Report implausible data or results, because the model may then be unreliable."""
    for text in found:
        note(Implausible(f"implausible: {text}"))


def report_uncertain_parameters(fitted: FittedModel, note: Callable[[str], object]) -> None:
    """Report the parameters whose standard deviation is larger than their value, if any.

    The exponentials of smooth creep may replace one another, though their sum is well determined.
    """
    uncertain = unidentified_parameters(fitted.model, fitted.uncertainties)
    pairs = len(fitted.model.creep.poles_rad_per_s)
    others = [name for name in uncertain if not name.startswith("creep ")]
    if pairs > 1 and len(uncertain) - len(others) > pairs:
        note(f"the recordings determine the creep as a whole, not each of its {pairs} exponentials")
        uncertain = others
    if uncertain:
        note(f"the recordings do not determine {', '.join(uncertain)}: the standard deviation is "
             "larger than the value; give a lower order, or record more")


def validation_errors(model: StageModel, recordings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the errors on all stretches of the validation; empty if it is not given."""
    validation = of_kind(recordings, "validation")
    return dict(unseen_errors(model, validation)) if validation else {}


def identified_model(
    fitted: FittedModel, errors: dict[str, Any], given: Mapping[str, Data],
    rows: Mapping[str, RowDelay],
) -> IdentifiedModel:
    """Return the model with its voltage range, its errors, and its recordings as read."""
    hysteresis = fitted.model.hysteresis
    return IdentifiedModel(
        model=fitted.model,
        voltage_range_v=(hysteresis.voltage_min_v, hysteresis.voltage_max_v),
        sample_periods_s={
            name: data.select(data.playing).sample_period_s for name, data in given.items()
            if name != "validation" and not isinstance(data, FrequencyResponse)
        },
        errors=errors,
        recordings=[origin_of(data) for data in given.values()],
        uncertainties=fitted.uncertainties, visited=fitted.visited,
        rows={name: row.fields() for name, row in rows.items()},
    )
