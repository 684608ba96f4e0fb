# SPDX-License-Identifier: BSD-3-Clause
"""Result of an estimator, with standard deviations and the reasons for the chosen order."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.row_alignment import MOST_UNCERTAIN, SIGNIFICANT
from piezo_models.cascade import StageModel
from piezo_models.effects.effect import Effect
from piezo_models.linear.dynamics import CreepDynamics

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DECISIVE = 10.0
"""Difference of the criterion above which the evidence is very strong (Kass and Raftery 1995);
a picture is linear below it."""

SHOWN = 12
"""Number of trials shown in a table of orders."""

RANK_TOLERANCE = 1e-12
"""Singular value, relative to the largest, below which a direction of scaled columns is
rounding."""

LEAST_DELAY = 0.01
"""Delays below this, in sample periods, are neglected: clocks jitter by as much."""

FINEST = 1e-9
"""Residual relative to the signal that no converter resolves: smaller ones differ by rounding
only."""

ROWS_OF_DECAY = 1.0
"""Smallest time constant of creep, in rows of a recording. The rows show only a part of each step
of faster decays."""

UNIDENTIFIED_SHARE = 1e-3
"""Smallest share in a direction lost to rounding that makes a parameter not identifiable."""

MOST_ALIKE = 0.98
"""Largest correlation of neighbouring samples of a residual that is taken into account."""


@dataclass(frozen=True)
class OrderTrial:
    """A fit of one order."""

    order: Any
    """Orders of the fit: pairs of creep poles and zeros, or vibration modes."""
    parameters: int
    """Number of free parameters of the fit."""
    residual_rms: float
    """RMS residual in the unit of the fitted output."""
    information: float
    """Bayesian information criterion; the smallest is best."""
    refusal: str = ""
    """Why the fit cannot be used whatever the criterion says; empty otherwise."""


@dataclass(frozen=True)
class DelayEstimate:
    """Delay of a recording's displacement behind its voltage, in addition to the dynamics."""

    delay_s: float
    """Negative if the displacement of a row is read after its voltage changes."""
    standard_deviation_s: float
    """Standard deviation of the delay, on which its significance depends."""
    sample_period_s: float
    """Sample period of the recording."""

    @property
    def samples(self) -> float:
        """Delay in sample periods of the recording."""
        return self.delay_s / self.sample_period_s

    @property
    def is_significant(self) -> bool:
        """Whether the delay is longer than its uncertainty and clock jitter explain."""
        return (abs(self.samples) > LEAST_DELAY
                and abs(self.delay_s) > SIGNIFICANT * self.standard_deviation_s)

    @property
    def is_identifiable(self) -> bool:
        """Whether the rows determine the delay, or at least that it is short."""
        return self.is_significant or (
            self.standard_deviation_s < MOST_UNCERTAIN * self.sample_period_s)

    def __str__(self) -> str:
        if not self.is_identifiable:
            return "not identifiable from these rows, left out"
        verdict = "significant" if self.is_significant else "not significant, left out"
        return (f"{1e6 * self.delay_s:.4g} +- {1e6 * self.standard_deviation_s:.2g} us "
                f"({self.samples:.4g} sample periods), {verdict}")


@dataclass(frozen=True)
class Estimate:
    """A fitted model with its uncertainty and the trials that led to its order."""

    model: Any

    standard_deviations: dict[str, Any]
    """Standard deviation of every physical parameter, with the names and shapes of the model's
    fields. They follow from the sensitivities at the optimum and the variance of the residual,
    which is valid for a white residual."""
    order: Any

    trials: tuple[OrderTrial, ...]
    """Every order that was fitted."""
    order_given: bool = False
    """True if the user specified this order."""
    start: str = ""
    """Description of the initial state of the recording."""
    effects: tuple[Effect, ...] = ()
    """Additional effects of the stage model: modes in addition to those of `model`, a sensor
    lag."""
    effect_deviations: tuple[dict[str, float], ...] = ()
    """Standard deviations of the parameters of each effect, by their names."""
    delay: DelayEstimate | None = None
    """None if no delay was fitted."""
    creep: CreepDynamics = CreepDynamics()
    """For dynamics, creep in addition to the known one."""
    creep_deviations: dict[str, tuple[float, ...]] = field(default_factory=dict)
    """Standard deviations of its poles and zeros."""

    @property
    def residual_rms(self) -> float:
        """Residual of the chosen order, in the unit of the fitted output."""
        return self.chosen.residual_rms

    @property
    def chosen(self) -> OrderTrial:
        """The trial of the chosen order."""
        return next(trial for trial in self.trials if trial.order == self.order)

    @property
    def delay_s(self) -> float:
        """Delay of the displacement if it is significant; negative if rows are read late."""
        return self.delay.delay_s if self.delay is not None and self.delay.is_significant else 0.0

    @property
    def refusal(self) -> str:
        """Why the chosen order cannot be used, as none can; empty otherwise."""
        return next((trial.refusal for trial in self.trials if trial.order == self.order), "")

    def order_table(self) -> str:
        """Return the best trials, one per line, with the chosen one marked."""
        trials = self._best_trials()
        width = max(len("order"), *(len(str(trial.order)) for trial in trials))
        lines = [f"{'order':{width}}  parameters  residual RMS  information"]
        for trial in trials:
            mark = ""
            if trial.order == self.order:
                mark = "  <- given" if self.order_given else "  <- least information"
            lines.append(
                f"{trial.order!s:>{width}}  {trial.parameters:10d}  {trial.residual_rms:12.6g}  "
                f"{trial.information:11.1f}{mark}{'  ' if trial.refusal else ''}{trial.refusal}"
            )
        return "\n".join(lines)

    def plot(self) -> "Figure":
        """Draw how far the criterion of the best trials lies above the least, and their residual.

        A filled mark is the chosen order, a cross one that is refused whatever the criterion says.
        """
        from piezo_common.picture_style import BLUE, label, new_figure

        figure = new_figure(height_in=4.4)
        above, below = figure.subplots(2, 1, sharex=True)
        trials = self._best_trials()
        least = min(trial.information for trial in trials)
        for place, trial in enumerate(trials):
            style = {"color": BLUE, "marker": "x" if trial.refusal else "o",
                     "fillstyle": "full" if trial.order == self.order else "none"}
            above.plot(place, trial.information - least, **style)
            below.semilogy(place, trial.residual_rms, **style)
        above.set_yscale("symlog", linthresh=DECISIVE)
        below.set_xticks(range(len(trials)), [str(trial.order) for trial in trials], rotation=30)
        label(above, y="above the least (1)", title="Bayesian information criterion")
        label(below, "order", "residual RMS")
        return figure

    def _best_trials(self) -> list[OrderTrial]:
        """Return the trials of least information, and the chosen one, as they were tried."""
        worst = sorted(trial.information for trial in self.trials)[:SHOWN][-1]
        return [trial for trial in self.trials
                if trial.information <= worst or trial.order == self.order]


def order_trial(
    order: object, residual: FloatArray, parameters: int, signal: FloatArray | None = None,
) -> OrderTrial:
    """Rate a fit by its residual: the Bayesian information criterion N ln(mean square) + P ln N.

    The residual, (N,), has equal variances. The fitted signal, in the unit of the residual, is
    given if an exact fit leaves only rounding, which does not justify more parameters.
    """
    mean_square = np.mean(residual**2)
    least = 0.0 if signal is None else finest_power(signal)
    information = (residual.size * np.log(mean_square + least)
                   + parameters * np.log(residual.size))
    return OrderTrial(order, parameters, float(np.sqrt(mean_square)), float(information))


def finest_power(signal: FloatArray) -> float:
    """Return the mean square of a residual caused by rounding of a signal of shape (N,)."""
    return float(FINEST**2 * np.var(signal))


def independent_rows(residual: FloatArray) -> float:
    """Return the number of independent errors in a correlated residual of shape (N,)."""
    return residual.size * independent_share(residual)


def independent_share(residual: FloatArray) -> float:
    """Return the share of independent errors in a correlated residual of shape (N,)."""
    power = float(residual @ residual) or 1.0
    alike = float(np.clip(residual[1:] @ residual[:-1] / power, 0.0, MOST_ALIKE))
    return (1.0 - alike) / (1.0 + alike)


def without_span(columns: FloatArray, span: FloatArray) -> FloatArray:
    """Return columns with the part along orthonormal columns removed."""
    return np.asarray(columns - span @ (span.T @ columns))


def parameter_covariance(
    jacobian: FloatArray, residual: FloatArray, parameters: int | None = None,
) -> FloatArray:
    """Return the covariance, (P, P), of the parameters of a least-squares fit with white residual.

    The Jacobian of the residual, (N, P), is that at the optimum, in the same scale; linear
    parameters may be projected out, so that there are more free parameters than columns. A
    parameter that is not identifiable has an infinite variance and zero covariances.
    """
    variance = np.sum(residual**2) / (residual.size - (parameters or jacobian.shape[1]))
    spread, unknown = scaled_inverse(jacobian)
    covariance = variance * spread @ spread.T
    covariance[unknown, :] = covariance[:, unknown] = 0.0
    covariance[unknown, unknown] = np.inf
    return covariance


def propagated(sensitivity: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the covariance, (Q, Q), of quantities that depend on parameters.

    The variance of quantities that depend on unknown parameters is infinite. The sensitivity is (Q,
    P), and the covariance, (P, P), a result of `parameter_covariance`.
    """
    unknown = np.isinf(np.diag(covariance))
    finite = np.where(np.isinf(covariance), 0.0, covariance)
    result = sensitivity @ finite @ sensitivity.T
    reached = np.any(sensitivity[:, unknown] != 0.0, axis=1)
    result[reached, :] = result[:, reached] = 0.0
    result[reached, reached] = np.inf
    return result


def scaled_inverse(jacobian: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the inverse of the normal matrix of a Jacobian without squaring its condition.

    The Jacobian is (N, P). The result is the square root of the inverse, (P, P): ``spread @
    spread.T`` is the inverse of ``jacobian.T @ jacobian``, without the directions lost to rounding.
    Also return the parameters that are part of such a direction, and therefore not identifiable,
    (P,). There are at least as many rows as columns.
    """
    scale = np.linalg.norm(jacobian, axis=0)
    scale[scale == 0.0] = 1.0
    # Scaling prevents rates of very different size from being lost to rounding.
    _, values, right = np.linalg.svd(jacobian / scale, full_matrices=False)
    kept = values > RANK_TOLERANCE * values.max(initial=0.0)
    inverse = np.divide(1.0, values, out=np.zeros_like(values), where=kept)
    unknown = np.any(np.abs(right[~kept]) > UNIDENTIFIED_SHARE, axis=0)
    return right.T * inverse / scale[:, None], unknown


def unidentified_parameters(
    model: StageModel, standard_deviations: Mapping[str, Mapping[str, Any]],
) -> list[str]:
    """Return the names of parameters whose standard deviation is larger than their value.

    They are such as ``creep poles_rad_per_s 2``, counted from 1. A lag is excluded: a large
    deviation shows that it is short or absent. The standard deviations are those of creep and
    dynamics, with the names and shapes of their fields.
    """
    unidentified = []
    for part in ("creep", "dynamics"):
        deviations = {name: each for name, each in standard_deviations.get(part, {}).items()
                      if name != "time_constant_s"}
        for name, deviation in deviations.items():
            value = np.atleast_1d(getattr(getattr(model, part), name))
            wide = np.flatnonzero(np.atleast_1d(deviation) > np.abs(value))
            unidentified += [f"{part} {name} {index + 1}" if value.size > 1 else f"{part} {name}"
                       for index in wide]
    return unidentified


def creep_of_partial_fractions(
    rates: FloatArray, gains: FloatArray, covariance: FloatArray | None = None,
    fastest: float = np.inf,
) -> tuple[CreepDynamics, dict[str, Any]]:
    """Return creep 1 + sum g p / (s + p) as poles and zeros, with their standard deviations.

    Poles p and positive gains g are (P,). The deviations are empty if no covariance, (2 P, 2 P), of
    the rates, followed by the gains, is given. An exponential of at least the rate `fastest` counts
    as part of the immediate response.
    """
    rates, gains, covariance = _with_immediate(rates, gains, covariance, fastest)
    order = np.argsort(rates)
    rates, gains = rates[order], gains[order]
    coupling = np.sqrt(gains * rates)
    # The symmetric form keeps the zeros real.
    zeros = np.linalg.eigvalsh(np.diag(rates) + np.outer(coupling, coupling))
    model = CreepDynamics(tuple(rates.tolist()), tuple(zeros.tolist()))
    if covariance is None:
        return model, {}
    order = np.concatenate([order, rates.size + order])
    covariance = covariance[np.ix_(order, order)]
    distance = rates[None, :] - zeros[:, None]
    slope = -np.sum(gains * rates / distance**2, axis=1, keepdims=True)
    by_rate = (gains / distance - gains * rates / distance**2) / slope
    by_gain = (rates / distance) / slope
    sensitivity = np.column_stack([by_rate, by_gain])
    poles_std = np.sqrt(np.diag(covariance)[: rates.size])
    zeros_std = np.sqrt(np.diag(propagated(sensitivity, covariance)))
    return model, {
        "poles_rad_per_s": tuple(poles_std.tolist()), "zeros_rad_per_s": tuple(zeros_std.tolist())
    }


def _with_immediate(
    rates: FloatArray, gains: FloatArray, covariance: FloatArray | None, fastest: float,
) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Return the slower exponentials, with gains relative to all that is faster."""
    slow = rates < fastest
    immediate = 1.0 + gains[~slow].sum()
    kept = gains[slow] / immediate
    every = np.eye(rates.size)[slow]
    by_gain = (every - np.outer(kept, ~slow)) / immediate
    return rates[slow], kept, None if covariance is None else propagated(
        block_diag(every, by_gain), covariance)
