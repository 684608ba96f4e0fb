# SPDX-License-Identifier: BSD-3-Clause
"""A model that runs beside the stage, and sequential tests on what it leaves of the measurement.

The residual is cut into blocks. What the blocks have while nothing has changed is learned first: a
model has errors, and ordinary tracking repeats them. The memory is bounded however long it runs.
"""

from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.prediction.cusum import Cusum, threshold_of
from piezo_models.cascade import StageMemory, StageModel
from piezo_models.effects import Effect

STATISTICS = {
    "mean": "the displacement has an offset that the model lacks",
    "gain": "the displacement is larger or smaller than the model's, in proportion",
    "lag": "the displacement lags or leads the model's",
    "scatter": "what the model leaves has another size",
}
"""What each statistic of a block speaks of when it changes."""


@dataclass(frozen=True)
class MonitorSettings:
    """How a residual is watched.

    Attributes
    ----------
    block_s : float
        Length of a block: a few periods of what is tracked, so that blocks are alike.
    learning_blocks : int
        From which mean and scatter of the statistics are learned.
    false_alarms_per_hour : float
        Of all tests together, while nothing has changed.
    shift : float
        Change that is found fastest, in standard deviations of a block's statistic.
    unsure : float
        Standard deviations of the learned means by which the allowance is widened: what was
        learned is off by chance, and an endless sum would find it.
    """

    block_s: float = 0.2
    learning_blocks: int = 100
    false_alarms_per_hour: float = 0.1
    shift: float = 1.5
    unsure: float = 2.0

    @property
    def allowance(self) -> float:
        """Return what each sum subtracts from a value, in standard deviations."""
        return 0.5 * self.shift + self.unsure / float(np.sqrt(self.learning_blocks))

    @property
    def threshold(self) -> float:
        """Return the threshold of each of the one-sided sums."""
        blocks_an_hour = 3600.0 / self.block_s
        sums = 2 * len(STATISTICS)
        return threshold_of(
            sums * blocks_an_hour / self.false_alarms_per_hour, self.allowance)


@dataclass(frozen=True)
class Suspicion:
    """An alarm of one of the tests.

    Attributes
    ----------
    statistic : str
        A key of `STATISTICS`.
    at_s : float
        Time of the alarm since the first sample.
    since_s : float
        When the change is estimated to have begun.
    change : float
        Of the statistic since then at least, in standard deviations of a block; negative where it
        fell.
    """

    statistic: str
    at_s: float
    since_s: float
    change: float

    def sentence(self) -> str:
        """Tell what is suspected."""
        return (f"since {self.since_s:.1f} s {STATISTICS[self.statistic]}: its {self.statistic} "
                f"changed by {self.change:+.1f} standard deviations of a block")


class ModelMonitor:
    """Run a model beside the stage, and tell when it no longer fits.

    Parameters
    ----------
    model : StageModel
    sample_period_s : float
    settings : MonitorSettings, optional
    memory : StageMemory, optional
        Past of the stage before the first sample; by default it rested at 0 V.

    Raises
    ------
    ValueError
        If the model has an effect that remembers the whole past, or a block is too short.
    """

    def __init__(self, model: StageModel, sample_period_s: float,
                 settings: MonitorSettings | None = None,
                 memory: StageMemory | None = None) -> None:
        for effect in model.effects:
            if effect.remembers and type(effect).advance is Effect.advance and (
                    effect.place not in ("modes", "linear")):
                raise ValueError(f"the model has {effect.name}, which remembers all of the past: "
                                 "watch the stage with a model without it")
        self._settings = settings or MonitorSettings()
        self._block = round(self._settings.block_s / sample_period_s)
        if self._block < 8:
            raise ValueError(f"a block of {self._settings.block_s:g} s has {self._block} samples: "
                             "make it longer")
        self._model, self._period_s = model, sample_period_s
        self._memory = model.memory() if memory is None else memory.copy()
        self._waiting_v: list[FloatArray] = []
        self._waiting_um: list[FloatArray] = []
        self._blocks = 0
        self._begin_learning()

    @property
    def is_learning(self) -> bool:
        """Tell whether it still learns what is usual, and raises no alarm."""
        return self._tests is None

    def watch(self, voltage_v: FloatArray, displacement_um: FloatArray) -> list[Suspicion]:
        """Take the next samples; return the alarms that they raise.

        Parameters
        ----------
        voltage_v, displacement_um : ndarray, shape (N,)
            Of any number; they follow the ones before without a gap.

        Returns
        -------
        list of Suspicion
        """
        self._waiting_v.append(np.array(voltage_v, dtype=float))
        self._waiting_um.append(np.array(displacement_um, dtype=float))
        raised: list[Suspicion] = []
        while sum(part.size for part in self._waiting_v) >= self._block:
            raised += self._watch_block(*map(self._next_block, (self._waiting_v, self._waiting_um)))
        return raised

    def begin_anew(self, memory: StageMemory | None = None) -> None:
        """Learn anew, such as after a gap or where something else is tracked.

        Parameters
        ----------
        memory : StageMemory, optional
            Past of the stage; by default the model goes on where it is.
        """
        if memory is not None:
            self._memory = memory.copy()
        self._waiting_v.clear()
        self._waiting_um.clear()
        self._begin_learning()

    def _begin_learning(self) -> None:
        self._learned: list[FloatArray] = []
        self._tests: list[Cusum] | None = None
        self._usual = self._spread = np.zeros(len(STATISTICS))

    def _next_block(self, waiting: list[FloatArray]) -> FloatArray:
        joined = np.concatenate(waiting)
        waiting[:] = [joined[self._block :]]
        return joined[: self._block]

    def _watch_block(self, voltage_v: FloatArray,
                     displacement_um: FloatArray) -> list[Suspicion]:
        simulated_um = self._model.simulate(voltage_v, self._period_s, self._memory)
        found = block_statistics(displacement_um - simulated_um, simulated_um)
        self._blocks += 1
        if self._tests is None:
            self._learned.append(found)
            if len(self._learned) == self._settings.learning_blocks:
                self._end_learning()
            return []
        raised = []
        for name, value, test in zip(
                STATISTICS, (found - self._usual) / self._spread, self._tests, strict=True):
            changed = test.add(float(value))
            if changed:
                at_s = self._blocks * self._block * self._period_s
                since_s = at_s - abs(changed) * self._block * self._period_s
                least = self._settings.allowance + self._settings.threshold / abs(changed)
                raised.append(Suspicion(name, at_s, since_s, float(np.copysign(least, changed))))
        return raised

    def _end_learning(self) -> None:
        learned = np.array(self._learned)
        self._usual = learned.mean(axis=0)
        self._spread = np.array([long_run_deviation(column) for column in learned.T])
        self._learned = []
        threshold, allowance = self._settings.threshold, self._settings.allowance
        self._tests = [Cusum(threshold, allowance) for _ in STATISTICS]


def block_statistics(residual_um: FloatArray, simulated_um: FloatArray) -> FloatArray:
    """Return the statistics of a block in the order of `STATISTICS`, shape (4,).

    Parameters
    ----------
    residual_um, simulated_um : ndarray, shape (N,)

    Returns
    -------
    ndarray
        Mean in um; gain and lag as least squares of the residual on the motion and its
        derivative a sample; logarithm of the RMS about the mean.
    """
    moving_um = simulated_um - simulated_um.mean()
    speed_um = np.gradient(simulated_um)
    columns = np.column_stack([np.ones(residual_um.size), moving_um, speed_um])
    mean, gain, lag = np.linalg.lstsq(columns, residual_um, rcond=1e-9)[0]
    scatter_um = float(np.std(residual_um))
    return np.array([mean, gain, -lag, np.log(max(scatter_um, 1e-12))])


def long_run_deviation(values: FloatArray) -> float:
    """Return the standard deviation that the sum of many values grows by, root of their number.

    Parameters
    ----------
    values : ndarray, shape (N,)

    Returns
    -------
    float
        The standard deviation, widened as far as neighbours are alike (first-order
        autoregression), and never zero.
    """
    left = values - values.mean()
    power = float(left @ left)
    if power <= 0.0:
        return 1e-12
    alike = min(0.9, max(0.0, float(left[1:] @ left[:-1]) / power))
    return float(np.std(values, ddof=1) * np.sqrt((1.0 + alike) / (1.0 - alike)))
