# SPDX-License-Identifier: BSD-3-Clause
"""The parts of a feedback law, and checks that they fit together."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_models.hysteresis.preisach import PreisachModel

LARGEST_ORDER = 200
LARGEST_DELAY_TICKS = 8


class FeedbackLawError(ValueError):
    """A feedback law must not act; the message gives the part at fault and the remedy."""


@dataclass(frozen=True, eq=False)
class LinearBlock:
    """A discrete linear system x+ = A x + B u, y = C x + D u, with one input and one output.

    That of several axes has an input and an output for each.
    """

    a: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """Shape (n, n)."""
    b: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Shape (n,), or (n, axes)."""
    c: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Shape (n,), or (axes, n)."""
    d: float | FloatArray = 0.0
    """A number, or shape (axes, axes)."""

    @classmethod
    def of(cls, a: npt.ArrayLike, b: npt.ArrayLike, c: npt.ArrayLike,
           d: npt.ArrayLike, axes: int = 0) -> "LinearBlock":
        """Make a block from matrices in any layout: A row by row, B and C as rows or columns.

        With a number of axes, B, C and D are row by row; by default there is a single one, without
        a name. Raises `FeedbackLawError` if the numbers of elements do not fit each other.
        """
        a, b, c, d = (np.ravel(np.asarray(part, dtype=float)) for part in (a, b, c, d))
        if axes:
            order = b.size // axes
            if a.size != order**2 or not b.size == c.size == order * axes or d.size != axes**2:
                raise FeedbackLawError(
                    f"a linear block of {axes} axes has {a.size}, {b.size}, {c.size} and {d.size} "
                    f"elements of A, B, C and D: give n x n, n x {axes}, {axes} x n and "
                    f"{axes} x {axes}")
            return cls(a.reshape(order, order), b.reshape(order, axes), c.reshape(axes, order),
                       d.reshape(axes, axes))
        if d.size != 1 or a.size != b.size**2 or c.size != b.size:
            raise FeedbackLawError(
                f"a linear block has {a.size}, {b.size}, {c.size} and {d.size} elements of A, B, "
                "C and D: give n x n, n, n and 1")
        return cls(np.ascontiguousarray(a.reshape(b.size, b.size)), b, c, float(d[0]))

    @property
    def order(self) -> int:
        """Return the number of states."""
        return len(self.b)

    @property
    def empty(self) -> bool:
        """Return True if the output is zero for every input."""
        return self.order == 0 and not np.any(self.d)

    @property
    def matrices(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return A, B, C and D, all of two dimensions."""
        if self.b.ndim > 1:
            return self.a, self.b, self.c, np.asarray(self.d)
        return self.a, self.b[:, None], self.c[None, :], np.full((1, 1), self.d)

    def response(self, points: ComplexArray) -> ComplexArray:
        """Return the transfer function at points of the plane, shape (F,) or (F, axes, axes)."""
        a, b, c, d = self.matrices
        states = np.linalg.solve(points[:, None, None] * np.eye(self.order) - a,
                                 np.broadcast_to(b, (len(points), *b.shape)))
        response = np.asarray(d + c @ states, dtype=complex)
        return response if self.b.ndim > 1 else response[:, 0, 0]


@dataclass(frozen=True, eq=False)
class InverseHysteresis:
    """The inverse hysteresis that the sum of feedback and feedforward passes."""

    hysteresis: PreisachModel

    gain_um_per_v: float
    """Factor from the voltage of the blocks to an output of the hysteresis, in um/V."""
    held: bool = False
    """True to add the mean of the inverse's output over a tick, instead of each sample."""


@dataclass(frozen=True, eq=False)
class DeclaredPlant:
    """The plant that the law was designed for."""

    linear: LinearBlock
    """The stage behind its hysteresis (um per um), at the sample rate of the stage."""
    gains_um_per_v: FloatArray
    """Gains of the hysteresis in um/V at which the loop must be stable, (k,), or (k, axes)."""


@dataclass(frozen=True, eq=False)
class FeedbackLaw:
    """A feedback at the tick's rate, at the sample rate, or both, with its reference and limits.

    The error is reference minus displacement. The sum of the voltages of both blocks is limited. A
    law of several axes has a block at the tick's rate only, and no inverse; its limits are those of
    each axis. Raises `FeedbackLawError` if a part is not finite, too large, or does not fit the
    others.
    """

    tick: LinearBlock
    """Block at the tick's rate: from the mean error of a tick (um) to a voltage (V)."""
    observer: FloatArray
    """Factors that correct the state of `tick` by the voltage that the limits cut (anti-windup),
    (n,), or (n, axes)."""
    max_feedback_v: float

    once_um: FloatArray
    period_um: FloatArray
    """Expected displacement of each sample of the run in um, (N,), or (N, axes): `once_um` first,
    then `period_um` repeatedly; without a period the last value is held."""
    plant: DeclaredPlant

    start_sample: int = 0
    """Sample of the run before which no tick is fed back."""
    delay_ticks: int = 0
    """Ticks from the end of the measured tick to the tick in which the response acts."""
    sample: LinearBlock = field(default_factory=LinearBlock)
    """Block at the sample rate: from the error of the previous sample (um) to a voltage (V)."""
    inverse: InverseHysteresis | None = None
    """Inverse hysteresis that the voltage passes; None to add it to the feedforward."""
    max_error_um: float = np.inf
    """The stage must stop if the mean error of a tick exceeds the error before the feedback by more
    than this, in um."""
    fade_samples: int = 0
    """Samples over which the initial error is faded in. At first the law responds only to the
    change of the error, so that its voltage starts at 0. With 0 it responds to all of it."""
    axes: tuple[str, ...] = ()
    """Names of the axes in their order, if there are several."""

    def __post_init__(self) -> None:
        blocks = {"tick": self.tick, "sample": self.sample, "model": self.plant.linear}
        for name, block in blocks.items():
            if block.order > LARGEST_ORDER:
                raise FeedbackLawError(f"{name} has {block.order} states, more than "
                                       f"{LARGEST_ORDER}: reduce its order")
            for part in (block.a, block.b, block.c, block.d):
                _check_finite(part, name)
        if self.tick.empty and self.sample.empty:
            raise FeedbackLawError("neither tick nor sample feeds anything back: give one of them")
        if len(self.observer) != self.tick.order:
            raise FeedbackLawError(f"observer has {len(self.observer)} elements for "
                                   f"{self.tick.order} states of tick: give one for each")
        _check_finite(self.observer, "observer")
        _check_finite(self.once_um, "once_expected_um")
        _check_finite(self.period_um, "period_expected_um")
        if not len(self.once_um) + len(self.period_um):
            raise FeedbackLawError("no displacement is expected: give once_expected_um, "
                                   "period_expected_um or both")
        if not 0.0 < self.max_feedback_v < np.inf:
            raise FeedbackLawError(f"max_feedback_v is {self.max_feedback_v:g}: "
                                   "give a positive voltage")
        if not self.max_error_um > 0.0:
            raise FeedbackLawError(f"max_error_um is {self.max_error_um:g}: "
                                   "give a positive displacement")
        if not 0 <= self.delay_ticks <= LARGEST_DELAY_TICKS:
            raise FeedbackLawError(f"delay_ticks is {self.delay_ticks}: give 0 to "
                                   f"{LARGEST_DELAY_TICKS}")
        if self.fade_samples < 0:
            raise FeedbackLawError(f"fade_samples is {self.fade_samples}: give 0 or more")
        gains = np.asarray(self.plant.gains_um_per_v)
        if not self.plant.linear.order or np.any(self.plant.linear.d) or not gains.size or not (
                np.isfinite(gains) & (gains > 0.0)).all():
            raise FeedbackLawError("the declared model has no dynamics, answers at once, or has "
                                   "gains that are not positive: declare the model that the law "
                                   "was designed for")
        if self.inverse is not None:
            self._check_inverse(self.inverse)
        self._check_axes()

    def _check_axes(self) -> None:
        own = (len(self.axes),) if self.axes else ()
        if self.axes and not (self.sample.empty and self.inverse is None):
            raise FeedbackLawError("a law of several axes has sample, or an inverse: use "
                                   "tick alone")
        arrays = {"tick": self.tick.b, "observer": self.observer, "model": self.plant.linear.b,
                  "model_gains_um_per_v": np.asarray(self.plant.gains_um_per_v),
                  "once_expected_um": self.once_um, "period_expected_um": self.period_um}
        for name, values in arrays.items():
            if values.size and values.shape[1:] != own:
                raise FeedbackLawError(f"{name} of the law has {values.shape[1:]} columns for the "
                                       f"axes {self.axes}: give one for each")

    def _check_inverse(self, inverse: InverseHysteresis) -> None:
        if not 0.0 < inverse.gain_um_per_v < np.inf:
            raise FeedbackLawError(f"inverse_gain_um_per_v is {inverse.gain_um_per_v:g}: "
                                   "give a positive gain")
        if inverse.held and not self.sample.empty:
            raise FeedbackLawError("hold_inverse holds what sample changes: use one of both")
        hysteresis = inverse.hysteresis
        if (hysteresis.density_um_per_v2 < 0).any() or (hysteresis.reversible_um_per_v < 0).any():
            raise FeedbackLawError("the hysteresis has negative densities, so it has no inverse: "
                                   "identify it again")


def _check_finite(values: npt.ArrayLike, name: str) -> None:
    if not np.isfinite(values).all():
        raise FeedbackLawError(f"{name} holds a value that is not finite: design the law again")
