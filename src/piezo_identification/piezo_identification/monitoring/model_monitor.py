# SPDX-License-Identifier: BSD-3-Clause
"""A model that runs next to the stage, and the evidence that its error has grown.

The residual is divided into blocks. The usual error for the motion of a block is taken from the
model file and updated with all blocks so far. A sum of Bayes factors shows whether the error has
grown; see `usual_error` for both. The memory is bounded, however long it runs.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.monitoring.usual_error import ChangeEvidence, KnownError, UsualError
from piezo_models.cascade import StageMemory, StageModel
from piezo_models.effects import Effect

FOLLOWED_BLOCKS = 100
"""Number of blocks to which the line is fitted; older ones fade."""

FEWEST_BLOCKS = 3
"""Number of blocks after which a deviation is computed; before, it is 0."""

SETTLED_BLOCKS = 10
"""Number of blocks after which the line is known and the age of a run no longer counts."""

STATISTICS = {
    "mean": "as an offset",
    "gain": "in proportion to the motion",
    "lag": "in proportion to the speed",
    "scatter": "neither in proportion to the motion nor to the speed",
}
"""Components of the error of a block; the largest is reported."""

BAND_EDGES_HZ = (0.0, 10.0, 100.0, 1000.0, np.inf)
"""Edges (Hz) of the frequency bands in which the powers of motion and error are computed."""

LEAST_PART = 0.01
"""Motion in a band below this fraction of the whole motion makes no difference between kinds of
motion, nor does motion below this fraction of the travel."""

REMEMBERED_BLOCKS = 4096
"""Number of blocks whose start times are kept, to report when a change began."""

HOURS_BETWEEN_CHANGES = 1.0
"""Expected time between changes (h), from which the prior probability of a change follows."""


class SlowOffset:
    """Least-squares line through the means of a run over log time, with older ones fading.

    For any stage, creep that a model lacks grows with the logarithm of the time since a run began.
    The means are therefore expected on a line over that logarithm. The line also follows slow
    warming.
    """

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """Start a new run."""
        self._blocks = 0
        self._normal: FloatArray = np.zeros((2, 2))
        self._right: FloatArray = np.zeros(2)

    @property
    def age(self) -> float:
        """Return the logarithm of the blocks in the run, limited to `SETTLED_BLOCKS`."""
        return float(np.log(min(self._blocks, SETTLED_BLOCKS)))

    def take(self, mean_um: float) -> float:
        """Add the mean of the next block, and return its deviation from the line (um)."""
        self._blocks += 1
        at = np.array([1.0, np.log(self._blocks)])
        offset_um = 0.0
        if self._blocks > FEWEST_BLOCKS:
            offset_um = mean_um - float(at @ np.linalg.solve(self._normal, self._right))
        kept = 1.0 - 1.0 / FOLLOWED_BLOCKS
        self._normal = kept * self._normal + np.outer(at, at)
        self._right = kept * self._right + mean_um * at
        return offset_um


@dataclass(frozen=True)
class MonitorSettings:
    """Settings of the monitor."""

    block_s: float = 0.2
    """Duration of a block. A few periods of the reference make the blocks similar."""
    learning_blocks: int = 100
    """Blocks of a kind of motion from which its usual error is learned; older ones fade."""
    false_alarms_per_hour: float = 0.01
    """Highest rate of false alarms while nothing has changed."""
    alike: float = 0.1
    """Largest relative difference in motion between blocks of one kind."""

    @property
    def threshold(self) -> float:
        """Return the logarithm of the Bayes factor at which a change is reported."""
        return float(np.log(3600.0 / self.block_s / self.false_alarms_per_hour))

    def probability(self, logarithm: float) -> float:
        """Return the probability of a change from the logarithm of its Bayes factor."""
        odds = logarithm - np.log(3600.0 * HOURS_BETWEEN_CHANGES / self.block_s)
        return float(0.5 * (1.0 + np.tanh(0.5 * odds)))


@dataclass(frozen=True)
class Suspicion:
    """A reported change."""

    statistic: str
    """Largest component of the error: a key of `STATISTICS`."""
    at_s: float
    """Time of the report since the first sample."""
    since_s: float
    """Estimated time at which the change began."""
    usual_rms_um: float
    rms_um: float
    """RMS error of the model that is usual for this motion, and that of the last block."""
    probability: float
    """Probability (0 to 1) that the error has grown."""
    band_hz: tuple[float, float]
    """Frequency band with most of the error."""

    def sentence(self) -> str:
        """Describe the change in one sentence."""
        return (f"since {self.since_s:.1f} s the model errs by {self.rms_um:.3g} um where "
                f"{self.usual_rms_um:.3g} um are usual, most of it from {self.band_hz[0]:g} to "
                f"{self.band_hz[1]:g} Hz and {STATISTICS[self.statistic]} "
                f"(probability {self._probability()})")

    def _probability(self) -> str:
        return "above 0.9999" if self.probability > 0.9999 else f"{self.probability:.4f}"


class ModelMonitor:
    """Run a model next to the stage, and report when it no longer fits.

    Parameters
    ----------
    memory : StageMemory, optional
        State of the stage before the first sample; by default, it rested at 0 V.
    known : KnownError, optional
        Known error of the model; by default, it is unknown and learned during operation.

    Raises
    ------
    ValueError
        If the model has an effect that depends on the whole past, or a block is too short.
    """

    def __init__(self, model: StageModel, sample_period_s: float,
                 settings: MonitorSettings | None = None,
                 memory: StageMemory | None = None, known: KnownError | None = None) -> None:
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
        self._travel_um = model.hysteresis.travel_um
        self._begin_learning(known or KnownError())

    @property
    def block_samples(self) -> int:
        """Return the number of samples in a block."""
        return self._block

    @property
    def past_v(self) -> FloatArray:
        """Return the voltages in the memory of the hysteresis, ending with the present one."""
        memory = self._memory.hysteresis
        return memory.extremes_v[: memory.top + 1].copy()

    @property
    def is_learning(self) -> bool:
        """Return True until enough blocks were seen to learn the usual error."""
        return self._blocks < self._settings.learning_blocks

    def watch(self, voltage_v: FloatArray, displacement_um: FloatArray) -> list[Suspicion]:
        """Process the next samples, and return the changes that they show.

        Parameters
        ----------
        voltage_v, displacement_um : ndarray, shape (N,)
            Any number of samples that follow the previous ones without a gap.
        """
        self._waiting_v.append(np.array(voltage_v, dtype=float))
        self._waiting_um.append(np.array(displacement_um, dtype=float))
        raised: list[Suspicion] = []
        while sum(part.size for part in self._waiting_v) >= self._block:
            raised += self._watch_block(*map(self._next_block, (self._waiting_v, self._waiting_um)))
        return raised

    def pass_by(self, voltage_v: FloatArray, sample_period_s: float | None = None) -> None:
        """Process voltages, (N,), without testing them, such as on the way to a reference.

        Each is held for `sample_period_s`; by default, for the sample period of the monitor.
        """
        period_s = sample_period_s or self._period_s
        for slow in self._slow:
            slow.begin()
        waiting = np.concatenate([*self._waiting_v, np.empty(0)])
        self._waiting_v.clear()
        self._waiting_um.clear()
        for voltages_v, held_s in ((waiting, self._period_s), (voltage_v, period_s)):
            if voltages_v.size:
                self._advance(voltages_v, held_s)

    def begin_anew(self, memory: StageMemory | None = None, sample: int | None = None) -> None:
        """Restart learning without the known error of the model, such as after a gap.

        `memory` is the state of the stage; by default, the model keeps its present state. `sample`
        is the number of the next sample, to which times refer; by default, the count continues.
        """
        self._sample = self._sample if sample is None else sample
        if memory is not None:
            self._memory = memory.copy()
        self._waiting_v.clear()
        self._waiting_um.clear()
        self._begin_learning(KnownError())

    def _begin_learning(self, known: KnownError) -> None:
        self._usual = UsualError(known, len(BAND_EDGES_HZ), self._settings.learning_blocks)
        self._evidence = ChangeEvidence()
        self._begins: deque[int] = deque(maxlen=REMEMBERED_BLOCKS)
        self._slow, self._blocks = (SlowOffset(), SlowOffset()), 0

    def _next_block(self, waiting: list[FloatArray]) -> FloatArray:
        joined = np.concatenate(waiting)
        waiting[:] = [joined[self._block :]]
        return joined[: self._block]

    def _advance(self, voltage_v: FloatArray, sample_period_s: float) -> FloatArray:
        """Return the simulated displacement for further voltages, held for a sample period each."""
        if sample_period_s != self._period_s:
            self._memory.effects.clear()  # their pasts have the sample period of the monitor
        simulated_um = self._model.simulate(voltage_v, sample_period_s, self._memory)
        self._sample += round(voltage_v.size * sample_period_s / self._period_s)
        return simulated_um

    def _watch_block(self, voltage_v: FloatArray,
                     displacement_um: FloatArray) -> list[Suspicion]:
        self._begins.append(self._sample)
        simulated_um = self._advance(voltage_v, self._period_s)
        residual_um = displacement_um - simulated_um
        offset_um, slow_um = (
            slow.take(float(signal_um.mean()))
            for slow, signal_um in zip(self._slow, (residual_um, simulated_um), strict=True))
        motion_um = np.append(np.sqrt(band_powers(simulated_um, self._period_s)), abs(slow_um))
        features = self._features(simulated_um, motion_um)
        value = float(np.log(max(np.hypot(np.std(residual_um), offset_um), 1e-12)))
        expected = self._usual.expected(motion_um, features)
        change = self._evidence.add(value, expected)
        self._blocks += 1
        if change.logarithm < self._settings.threshold:
            self._usual.take(motion_um, features, value, 1.0 / (1.0 + np.exp(change.logarithm)))
            return []
        self._usual.grow(change.factor)
        self._evidence = ChangeEvidence()
        powers = band_powers(residual_um, self._period_s)
        most = int(np.argmax(powers))
        return [Suspicion(
            largest_part(residual_um, offset_um, simulated_um), self._sample * self._period_s,
            self._begins[-min(change.blocks, len(self._begins))] * self._period_s,
            float(np.exp(expected.middle)), float(np.exp(value)),
            self._settings.probability(change.logarithm),
            (BAND_EDGES_HZ[most], min(BAND_EDGES_HZ[most + 1], 0.5 / self._period_s)))]

    def _features(self, simulated_um: FloatArray, motion_um: FloatArray) -> FloatArray:
        """Return the features of a kind of motion, scaled for `UsualError.expected`.

        They are position, change of position, slow deviation, motion in the bands, and time in the
        run. A difference of 1 separates two kinds.
        """
        alike, least_um = self._settings.alike, LEAST_PART * self._travel_um
        scale_um = alike * np.std(simulated_um) + least_um
        floor_um = LEAST_PART * (np.std(simulated_um) + least_um)
        return np.concatenate([
            np.array([simulated_um.mean(), simulated_um[-1] - simulated_um[0], motion_um[-1]])
            / scale_um,
            np.log(motion_um[:-1] + floor_um) / alike, [self._slow[0].age]])


def band_powers(signal_um: FloatArray, sample_period_s: float) -> FloatArray:
    """Return the mean square (um^2) of a signal about its mean in the bands of `BAND_EDGES_HZ`.

    Their sum is the variance. The linear trend of the signal is counted in the lowest band.
    """
    line = np.linspace(-1.0, 1.0, signal_um.size)
    slope_um = float(line @ signal_um / (line @ line))
    remaining_um = signal_um - signal_um.mean() - slope_um * line
    spectrum = np.abs(np.fft.rfft(remaining_um) / remaining_um.size) ** 2
    spectrum[1 : (remaining_um.size + 1) // 2] *= 2.0
    frequency_hz = np.fft.rfftfreq(remaining_um.size, sample_period_s)
    powers = np.histogram(frequency_hz, BAND_EDGES_HZ, weights=spectrum)[0]
    powers[0] += slope_um**2 * float(np.mean(line**2))
    return powers


def largest_part(residual_um: FloatArray, offset_um: float, simulated_um: FloatArray) -> str:
    """Return the largest component of an error, (N,): a key of `STATISTICS`."""
    remaining_um = residual_um - residual_um.mean()
    powers = {"mean": offset_um**2}
    for name, shape_um in (("gain", simulated_um), ("lag", np.gradient(simulated_um))):
        varying_um = shape_um - shape_um.mean()
        along = float(varying_um @ remaining_um) / max(float(varying_um @ varying_um), 1e-300)
        powers[name] = along**2 * float(np.mean(varying_um**2))
    powers["scatter"] = float(np.mean(remaining_um**2)) - powers["gain"] - powers["lag"]
    return max(powers, key=lambda name: powers[name])
