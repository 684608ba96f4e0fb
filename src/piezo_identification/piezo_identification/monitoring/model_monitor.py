# SPDX-License-Identifier: BSD-3-Clause
"""A model that runs beside the stage, and sequential tests on what it leaves of the measurement.

The residual is cut into blocks. What the blocks have while nothing has changed is learned first: a
model has errors, and ordinary tracking repeats them. The memory is bounded however long it runs.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.monitoring.cusum import Cusum, threshold_of
from piezo_models.cascade import StageMemory, StageModel
from piezo_models.effects import Effect

STATISTICS = {
    "mean": "the displacement has an offset that the model lacks",
    "gain": "the displacement is larger or smaller than the model's, in proportion",
    "lag": "the displacement lags or leads the model's",
    "scatter": "what the model leaves has another size",
}
"""What each statistic of a block speaks of when it changes."""


BAND_EDGES_HZ = (0.0, 10.0, 100.0, 1000.0, np.inf)
"""Of the bands in which the residual is told to have grown: a decade each."""

LEAST_OFFSET = 0.1
"""Part of the usual residual that a deviation of its mean is at least: a creep that the model has
not quite moves it by less for ever."""

REMEMBERED_BLOCKS = 4096
"""Of which the beginning is remembered, for when a change began."""


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
    alike : float
        Part of its motion by which a block may differ from the one before. A changed stage
        moves otherwise under the same voltage, or takes another voltage for the same motion. Where
        both are others, something else is tracked.
    patience : int
        Blocks of something else, one after the other, after which the monitor learns anew.
    """

    block_s: float = 0.2
    learning_blocks: int = 100
    false_alarms_per_hour: float = 0.1
    shift: float = 1.5
    unsure: float = 2.0
    alike: float = 0.1
    patience: int = 5

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
    usual_rms_um, rms_um : float
        Of the residual about its mean, before the change and in the block of the alarm.
    band_hz : (float, float)
        In which the power of the residual grew most.
    """

    statistic: str
    at_s: float
    since_s: float
    change: float
    usual_rms_um: float = 0.0
    rms_um: float = 0.0
    band_hz: tuple[float, float] = (0.0, 0.0)

    def sentence(self) -> str:
        """Tell what is suspected."""
        return (f"since {self.since_s:.1f} s {STATISTICS[self.statistic]}: its {self.statistic} "
                f"changed by {self.change:+.1f} standard deviations of a block")


class ModelMonitor:
    """Run a model beside the stage, and tell when it no longer fits.

    Parameters
    ----------
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
        self._sample = 0
        self._begin_learning()

    @property
    def block_samples(self) -> int:
        """Return the samples of a block."""
        return self._block

    @property
    def past_v(self) -> FloatArray:
        """Return the voltages that the hysteresis remembers, the present one last."""
        memory = self._memory.hysteresis
        return memory.extremes_v[: memory.top + 1].copy()

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
        """
        self._waiting_v.append(np.array(voltage_v, dtype=float))
        self._waiting_um.append(np.array(displacement_um, dtype=float))
        raised: list[Suspicion] = []
        while sum(part.size for part in self._waiting_v) >= self._block:
            raised += self._watch_block(*map(self._next_block, (self._waiting_v, self._waiting_um)))
        return raised

    def pass_by(self, voltage_v: FloatArray, sample_period_s: float | None = None) -> None:
        """Take samples that are not tested, such as on the way to a reference.

        Parameters
        ----------
        voltage_v : ndarray, shape (N,)
        sample_period_s : float, optional
            For which each voltage is held, where that is not the one of the monitor.
        """
        period_s = sample_period_s or self._period_s
        waiting = np.concatenate([*self._waiting_v, np.empty(0)])
        self._waiting_v.clear()
        self._waiting_um.clear()
        for voltages_v, held_s in ((waiting, self._period_s), (voltage_v, period_s)):
            if voltages_v.size:
                self._advance(voltages_v, held_s)

    def begin_anew(self, memory: StageMemory | None = None, sample: int | None = None) -> None:
        """Learn anew, such as after a gap or where something else is tracked.

        Parameters
        ----------
        memory : StageMemory, optional
            Past of the stage; by default the model goes on where it is.
        sample : int, optional
            Number of the next sample, from which times are told; by default the count goes on.
        """
        self._sample = self._sample if sample is None else sample
        if memory is not None:
            self._memory = memory.copy()
        self._waiting_v.clear()
        self._waiting_um.clear()
        self._begin_learning()

    def _begin_learning(self) -> None:
        self._learned: list[FloatArray] = []
        self._tests: list[Cusum] | None = None
        self._usual = self._spread = np.zeros(len(STATISTICS))
        self._motion: FloatArray | None = None
        self._powers: list[FloatArray] = []
        self._unlike = 0
        self._begins: deque[int] = deque(maxlen=REMEMBERED_BLOCKS)

    def _next_block(self, waiting: list[FloatArray]) -> FloatArray:
        joined = np.concatenate(waiting)
        waiting[:] = [joined[self._block :]]
        return joined[: self._block]

    def _advance(self, voltage_v: FloatArray, sample_period_s: float) -> FloatArray:
        """Return what the model does with further voltages, each held for a sample period."""
        if sample_period_s != self._period_s:
            self._memory.effects.clear()  # whose pasts are of this monitor's samples
        simulated_um = self._model.simulate(voltage_v, sample_period_s, self._memory)
        self._sample += round(voltage_v.size * sample_period_s / self._period_s)
        return simulated_um

    def _watch_block(self, voltage_v: FloatArray,
                     displacement_um: FloatArray) -> list[Suspicion]:
        begin = self._sample
        simulated_um = self._advance(voltage_v, self._period_s)
        residual_um = displacement_um - simulated_um
        motion = np.array([motion_of(simulated_um), motion_of(displacement_um)])
        powers = band_powers(residual_um, self._period_s)
        if self._tests is None:
            if self._is_other(motion):
                self._begin_learning()
            self._motion = motion
            self._learn(block_statistics(residual_um, simulated_um), powers)
            return []
        if self._is_other(motion):
            self._unlike += 1
            if self._unlike >= self._settings.patience:
                self._begin_learning()
            return []
        self._unlike, self._motion = 0, motion  # which creeps
        self._begins.append(begin)
        found = (block_statistics(residual_um, simulated_um) - self._usual) / self._spread
        grown = int(np.argmax(powers - self._power))
        return [
            self._suspicion(name, changed, powers, grown)
            for name, value, test in zip(STATISTICS, found, self._tests, strict=True)
            if (changed := test.add(float(value)))]

    def _suspicion(self, name: str, changed: int, powers: FloatArray, grown: int) -> Suspicion:
        since = self._begins[-min(abs(changed), len(self._begins))]
        least = self._settings.allowance + self._settings.threshold / abs(changed)
        return Suspicion(
            name, self._sample * self._period_s, since * self._period_s,
            float(np.copysign(least, changed)), float(np.sqrt(self._power.sum())),
            float(np.sqrt(powers.sum())),
            (BAND_EDGES_HZ[grown], min(BAND_EDGES_HZ[grown + 1], 0.5 / self._period_s)))

    def _is_other(self, motion: FloatArray) -> bool:
        """Tell whether both the model and the stage move otherwise than in the block before."""
        than = self._motion
        if than is None:
            return False
        scale = np.maximum(than[:, 1:2], np.finfo(float).tiny)
        return bool(np.all(np.any(
            np.abs(motion - than) > self._settings.alike * scale, axis=1)))

    def _learn(self, found: FloatArray, powers: FloatArray) -> None:
        self._learned.append(found)
        self._powers.append(powers)
        if len(self._learned) == self._settings.learning_blocks:
            self._end_learning()

    def _end_learning(self) -> None:
        learned = np.array(self._learned)
        self._usual = learned.mean(axis=0)
        self._spread = np.array([long_run_deviation(column) for column in learned.T])
        self._power = np.mean(self._powers, axis=0)
        mean = list(STATISTICS).index("mean")
        self._spread[mean] = max(
            self._spread[mean], LEAST_OFFSET * float(np.sqrt(self._power.sum())))
        self._learned, self._powers = [], []
        threshold, allowance = self._settings.threshold, self._settings.allowance
        self._tests = [Cusum(threshold, allowance) for _ in STATISTICS]


def motion_of(displacement_um: FloatArray) -> FloatArray:
    """Return mean and standard deviation of a block, shape (2,).

    Parameters
    ----------
    displacement_um : ndarray, shape (N,)
    """
    return np.array([displacement_um.mean(), displacement_um.std()])


def band_powers(residual_um: FloatArray, sample_period_s: float) -> FloatArray:
    """Return the mean square of a residual about its mean in the bands of `BAND_EDGES_HZ`.

    Parameters
    ----------
    residual_um : ndarray, shape (N,)

    Returns
    -------
    ndarray, shape (4,)
        In um^2; by Parseval they sum to the variance.
    """
    spectrum = np.abs(np.fft.rfft(residual_um - residual_um.mean()) / residual_um.size) ** 2
    spectrum[1 : (residual_um.size + 1) // 2] *= 2.0
    frequency_hz = np.fft.rfftfreq(residual_um.size, sample_period_s)
    return np.histogram(frequency_hz, BAND_EDGES_HZ, weights=spectrum)[0]


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
