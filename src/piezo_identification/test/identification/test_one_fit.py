# SPDX-License-Identifier: BSD-3-Clause
"""What the separate steps were wrong about is mended by the one fit."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from piezo_identification.conditioning.outlier_samples import with_outliers_marked
from piezo_identification.estimators.frequency_response.response_model import ANY_ORDER
from piezo_identification.experiments import catalogue as experiments
from piezo_identification.fitting.whole_model import NARROW_PRIOR, WIDE_PRIOR
from piezo_identification.identification import one_fit
from piezo_identification.identification.linear_dynamics import FittedModel
from piezo_identification.identification.one_fit import (
    _best_of,
    _long_ones,
    _Search,
    _State,
    fitted_together,
    reliable,
)
from piezo_models import CreepDynamics, ElectricVibrationDynamics, PreisachModel, StageModel


def test_errors_that_repeat_widen_the_standard_deviations_of_what_they_affect():
    deviations = {"creep": {"poles_rad_per_s": (0.1, 0.2)}, "dynamics": {"time_constant_s": 0.5},
                  "effects": [{"delay_s": 0.25}]}
    adequacy = {name: {"verdict": "adequate", "ratio": ratio}
                for name, ratio in (("creep", 0.9), ("dynamics", 5.0), ("hysteresis", 1.5))}
    assert reliable(deviations, adequacy, False) == {
        "creep": {"poles_rad_per_s": pytest.approx((0.15, 0.3))},
        "dynamics": {"time_constant_s": 2.5}, "effects": [{"delay_s": 1.25}]}
    adequacy["dynamics 2"] = {"verdict": "inadequate", "ratio": 2.0}
    assert list(reliable(deviations, adequacy, False)) == ["creep"]


@pytest.mark.long
def test_rows_that_were_taken_for_late_are_read_with_their_voltage(plant, play):
    """The separate steps read the fast rows a quarter of a period late, which the data refute."""
    recordings = {name: with_outliers_marked(each) for name, each in (
        ("dynamics", play(experiments.dynamics(duration_s=0.2), 1)),
        ("hysteresis", play(experiments.hysteresis(level_count=8, harmonic_period_s=1.0), 1,
                            1000.0)))}
    nothing_visited = np.zeros(plant.hysteresis.density_um_per_v2.shape, dtype=bool)
    together = fitted_together(
        FittedModel(plant, {}, nothing_visited), recordings, {"dynamics": 0.25, "hysteresis": 0.0},
        None, ANY_ORDER, lambda *_: None, lambda _: None)
    assert together.read_at == {"dynamics": 0.0, "hysteresis": 0.0}
    assert not together.fitted.model.effects


def test_loops_that_were_taken_for_late_are_read_with_their_voltage(recorded):
    """The separate steps read rows of 10 ms 4 ms late, which the loops refute."""
    time_s = 0.01 * np.arange(1500)
    voltage_v = (5.0 - 5.0 * np.cos(2.0 * np.pi * time_s)) * np.linspace(1.0, 0.3, time_s.size)
    stage = StageModel(PreisachModel(0.0, 10.0, np.tril(np.full((5, 5), 0.04))), CreepDynamics(),
                       ElectricVibrationDynamics(3e-3))
    displacement_um = stage.simulate(voltage_v, 0.01)
    fast_um = stage.simulate(voltage_v, 1e-3)
    given = FittedModel(stage, {}, np.ones((5, 5), dtype=bool))
    together = fitted_together(
        given, {"hysteresis": recorded("loops", voltage_v, displacement_um, 0.01, 0.01),
                "dynamics": recorded("fast", voltage_v, fast_um, 1e-3, 0.01)},
        {"hysteresis": 0.4, "dynamics": 0.0}, None, ANY_ORDER, lambda *_: None, lambda *_: None)
    assert together.read_at == {"hysteresis": 0.0, "dynamics": 0.0}
    np.testing.assert_allclose(
        together.fitted.model.simulate(voltage_v, 0.01), displacement_um, atol=0.01)


def test_short_stretches_are_fitted_where_an_experiment_has_no_others_alone(plant, recorded):
    rows = {"dynamics": 80, "hysteresis": 4000, "hysteresis 2": 60}
    given = {name: recorded(name, np.arange(count) % 7.0, np.zeros(count), 1e-3)
             for name, count in rows.items()}
    assert [*_long_ones(plant, given)] == ["dynamics", "hysteresis"]


def test_a_fit_that_would_read_rows_too_late_is_not_written_and_that_is_said(
        recorded, monkeypatch):
    monkeypatch.setattr(one_fit, "LATEST_READING", -1.0)  # every reading is too late
    voltage_v = 5.0 - 5.0 * np.cos(0.1 * np.arange(300))
    line = StageModel(PreisachModel.line(0.0, 10.0, 2.0), CreepDynamics(),
                      ElectricVibrationDynamics())
    given, notes = FittedModel(line, {}, np.ones((1, 1), dtype=bool)), list[str]()
    together = fitted_together(
        given, {"hysteresis": recorded("loops", voltage_v, 1.9 * voltage_v, 0.01)},
        {"hysteresis": 0.0}, None, ANY_ORDER, lambda *_: None, notes.append)
    assert together.fitted is given
    assert together.read_at == {"hysteresis": 0.0}
    assert len(notes) == 1 and "the model is that of the separate steps" in notes[0]


WITH_PIECES = SimpleNamespace(
    forget_pieces=lambda: None, over_noise=lambda fit: np.array([fit.over_noise]))


class _Fit(SimpleNamespace):
    numbers, errors, over_noise = 1, WITH_PIECES, 10.0
    model = SimpleNamespace(effects=())

    def evidence_over(self, other):
        return self.evidence - other.evidence

    def held_out_over(self, other):
        return 0.0


class _Racing(_Search):
    """A search in which each estimate of the loops changes the evidence as listed."""

    def __init__(self, *evidence):
        self.__dict__.update(
            new_loops=True, problem=None, made=[], widths=[], evidence=evidence)

    def _searched(self, start, begin, length):
        return start

    def _with_renewed_loops(self, before, fraction, width=0.0):
        self.made.append(before.best.start)
        self.widths.append(width)
        left = self.evidence[before.best.start][self.made.count(before.best.start) :]
        return replace(before, best=_Fit(start=before.best.start, evidence=left[0])
                       ) if left else before

    def states(self):
        return [_State(None, _Fit(start=start, evidence=listed[0]), WITH_PIECES, {})
                for start, listed in enumerate(self.evidence)]

    def raced(self):
        return self._with_loops_in_turns(self.states())


def test_a_start_behind_may_lead_once_its_loops_were_estimated_again():
    search = _Racing([6200.0, 7200.0], [4400.0, 7000.0, 8700.0, 9000.0], [1000.0, 9999.0])
    states = search.raced()
    assert _best_of(states).best.start == 1
    assert _best_of(states).best.evidence == 9000.0
    # The last one is too far behind to be tried.
    assert search.made.count(2) == 0
    assert {state.best.start for state in states} == {0, 1, 2}


def test_a_start_near_the_noise_has_no_rival_with_the_same_amplifier(monkeypatch):
    monkeypatch.setattr(_Fit, "over_noise", 2.0)
    monkeypatch.setattr(one_fit, "has_amplifier", lambda fit: fit.start == 2)
    search = _Racing([6200.0, 7200.0], [6100.0, 9999.0], [5000.0, 7500.0])
    search.raced()
    assert set(search.made) == {0, 2}


def test_the_start_of_the_separate_steps_has_a_rival_even_near_the_noise(monkeypatch):
    monkeypatch.setattr(_Fit, "over_noise", 2.0)
    search = _Racing([6200.0, 7200.0], [6100.0, 9999.0], [5000.0, 7500.0])
    first, *others = search.states()
    search.__dict__["problem"] = first.problem
    others = [replace(state, problem=SimpleNamespace(**vars(WITH_PIECES))) for state in others]
    assert _best_of(search._with_loops_in_turns([first, *others])).best.start == 1
    assert search.made.count(2) == 0


def test_a_start_that_gains_less_than_it_is_behind_gets_no_further_loops():
    search = _Racing([9000.0, 9500.0, 9510.0], [7000.0, 7100.0, 9999.0])
    assert _best_of(search.raced()).best.start == 0
    assert search.made.count(1) == 1


def test_loops_are_estimated_freely_after_a_search_while_that_adds_evidence_and_then_with_a_prior():
    search = _Racing([1000.0, 1500.0, 1505.0, 1700.0, 1701.0])
    assert search._from(*search.states(), 0.0, 1.0).best.evidence == 1701.0
    assert search.widths == [WIDE_PRIOR, WIDE_PRIOR, NARROW_PRIOR, NARROW_PRIOR]


@pytest.mark.parametrize("before, left, are_explained", [
    ((11.4, 12.3), (24.4, 5.0), False), ((11.4, 12.3), (11.0, 20.0), True),
    ((1.2, 70.0), (2.9, 60.0), True), ((1.2, 70.0), (3.1, 60.0), False)])
def test_a_hysteresis_of_another_kind_explains_loops_as_well_or_nearly(
        before, left, are_explained):
    problem = SimpleNamespace(over_noise=lambda fit: np.array(fit.left))
    search = _Racing()
    search.__dict__["names"] = ["hysteresis", "dynamics"]
    drifting, state = (_State(None, _Fit(left=each), problem, {}) for each in (left, before))
    assert search._explains_loops(drifting, state) == are_explained
