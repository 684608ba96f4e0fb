# SPDX-License-Identifier: BSD-3-Clause
"""Search for initial values to tune a controller of fixed order.

Random initial values are tuned over the stages of a small error of the light mode, then of larger
ones. The best result is then changed at random repeatedly: either all parameters by a little, or
one pair of zeros and one of poles to a pair that cancels. Changes that reduce the cost are kept.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_controller.feedback.sample_rate.demands import Demands
from piezo_controller.feedback.sample_rate.minimax import Linearised, lower_largest
from piezo_controller.feedback.sample_rate.tuned_over_stages import (
    START,
    LoopProblem,
    Start,
    tuned_family,
)
from piezo_controller.feedback.synthesis.generalised_plant import nominal_hysteresis_gain
from piezo_models.cascade import StageModel
from piezo_studies.thesis.identified_stage import identified_stage

SUMMARY = "Search for where the tuning of a controller of fixed order begins."

FIRST_GAIN = 2.0
"""Logarithm of the initial integral gain of random controllers; reduced if the loop is unstable."""

Resonances = tuple[tuple[tuple[float, float], tuple[float, float]], ...]

FIRST_ERRORS = (0.05, 0.10)
"""Errors of the light mode over which initial values are tuned before the requested error."""

COARSE = 240
"""Number of frequencies over the whole band; with fewer, a search can hide peaks between them."""

START_STEPS, FEW_STEPS, STEPS = 120, 25, 200
PROMISING = 0.5
SIZES, SHARES = (0.02, 0.06, 0.15, 0.4), (0.15, 0.5, 1.0)
REDRAWN = 0.3
"""Fraction of trials in which pairs are redrawn."""


class Search:
    """Tune controllers of fixed order over the stages of a model."""

    def __init__(self, model: StageModel, demands: Demands,
                 clock_period_s: float = 25e-6) -> None:
        self._like = START
        family = tuned_family(model, demands, clock_period_s)
        self.structure, self._with_resonances = family.structure, family.start
        self._disturbances = [2 * np.pi * hz / self.structure.unit_rad_per_s
                              for hz in demands.disturbance_hz]
        asked = demands.errors.light_mode
        first_mode_hz = min(model.dynamics.mode_frequencies_rad_per_s) / (2 * np.pi)
        self._problems = []
        for error in (*(first for first in FIRST_ERRORS if first < asked), asked):
            these = replace(demands, errors=replace(demands.errors, light_mode=error))
            loops = these.loops(model, clock_period_s, coarse=COARSE)
            self._problems.append(LoopProblem(loops, these, self.structure, first_mode_hz,
                                              nominal_hysteresis_gain(model)))

    def run(self, seed: int, starts: int, trials: int,
            report: Callable[[str, FloatArray, float], None]) -> float:
        """Search, and return the largest margin found (dB).

        A number of random initial values, and of random changes of the best result, are tried.
        Exceeded bounds reduce the margin to the demands. Each improvement is reported by its name,
        the best parameters and their margin.
        """
        rng = np.random.default_rng(seed)
        best, least = np.empty(0), np.inf
        for number in range(starts + trials):
            drawn = number < starts
            if drawn:
                numbers, found = self.from_anywhere(rng)
            else:
                numbers, found = self._tuned(self._changed(best, rng), FEW_STEPS)
                if found.cost < least + PROMISING:
                    numbers, found = self._tuned(numbers, STEPS)
            if found.allowed and found.cost < least:
                best, least = numbers, found.cost
                report(f"start {number + 1}" if drawn else f"trial {number + 1 - starts}",
                       best, -least)
        return -least

    def from_anywhere(self, rng: np.random.Generator) -> tuple[FloatArray, Linearised]:
        """Draw parameters, and tune them over increasing errors."""
        numbers = self.drawn(rng)
        for problem in self._problems:
            numbers, found = self._tuned(numbers, START_STEPS, problem)
        return numbers, found

    def drawn(self, rng: np.random.Generator) -> FloatArray:
        """Draw all parameters except those of resonances, log-uniformly for most."""
        def logarithms(lowest: float, highest: float, count: int) -> FloatArray:
            return np.asarray(rng.uniform(np.log(lowest), np.log(highest), count))

        like, numbers = self._like, self._with_resonances.copy()
        zeros, poles = self._pairs_from
        numbers[0] = FIRST_GAIN
        numbers[1:zeros] = np.concatenate([logarithms(0.1, 10.0, len(like.real_zeros)),
                                           logarithms(1.0, 10.0, len(like.real_poles))])
        count = len(like.zeros)
        numbers[zeros:zeros + 2 * count] = np.column_stack(
            [logarithms(0.2, 8.0, count), rng.uniform(0.02, 1.0, count)]).ravel()
        count = len(like.poles)
        numbers[poles:poles + 2 * count] = np.column_stack(
            [logarithms(0.3, 8.0, count), logarithms(0.02, 3.0, count)]).ravel()
        return numbers

    def as_start(self, numbers: FloatArray) -> Start:
        """Return parameters as a `Start`, without resonances."""
        like = self._like
        zeros, poles = self._pairs_from
        real = np.exp(numbers[1:zeros])
        return Start(
            float(numbers[0]), _floats(real[:len(like.real_zeros)]),
            _floats(real[len(like.real_zeros):]),
            tuple((float(np.exp(frequency)), float(damping)) for frequency, damping
                  in numbers[zeros:zeros + 2 * len(like.zeros)].reshape(-1, 2)),
            tuple((float(frequency), float(damping)) for frequency, damping
                  in np.exp(numbers[poles:poles + 2 * len(like.poles)]).reshape(-1, 2)))

    def as_resonances(self, numbers: FloatArray) -> Resonances:
        """Return the parameters of the resonances in the form of `tuned_over_stages.RESONANCES`."""
        zeros, poles = self._pairs_from
        of_zeros = numbers[zeros + 2 * len(self._like.zeros):poles].reshape(-1, 2)
        of_poles = np.exp(numbers[poles + 2 * len(self._like.poles):].reshape(-1, 2))
        units = self._disturbances
        return tuple(
            ((float(np.exp(zero[0]) / unit), float(zero[1])),
             (float(pole[0] / unit), float(pole[1])))
            for unit, zero, pole in zip(units, of_zeros, of_poles, strict=False))

    @property
    def _pairs_from(self) -> tuple[int, int]:
        """Return the indices of the first pair of zeros and of the first pair of poles."""
        zeros = 1 + self.structure.real_zeros + self.structure.real_poles
        return zeros, zeros + 2 * self.structure.zero_pairs

    def _tuned(self, numbers: FloatArray, steps: int,
               problem: LoopProblem | None = None) -> tuple[FloatArray, Linearised]:
        """Reduce the cost, after reducing the gain until the loops are stable."""
        problem = problem or self._problems[-1]
        low, high = self.structure.bounds
        numbers = np.clip(numbers, low, high)
        while not problem.linearise(numbers).allowed and numbers[0] > low[0]:
            numbers[0] -= np.log(2.0)
        return lower_largest(problem.linearise, numbers, low, high, steps)

    def _changed(self, numbers: FloatArray, rng: np.random.Generator) -> FloatArray:
        if rng.random() >= REDRAWN:
            changed = rng.random(numbers.size) < rng.choice(SHARES)
            return numbers + changed * rng.normal(size=numbers.size) * rng.choice(SIZES)
        numbers = numbers.copy()
        zeros, poles = self._pairs_from
        zero = zeros + 2 * rng.integers(len(self._like.zeros))
        pole = poles + 2 * rng.integers(len(self._like.poles))
        frequency, damping = rng.uniform(np.log([0.25, 0.03]), np.log([6.0, 1.0]))
        numbers[zero:zero + 2] = frequency, np.exp(damping)
        numbers[pole:pole + 2] = frequency, damping
        return numbers


def _floats(values: Iterable[float]) -> tuple[float, ...]:
    return tuple(map(float, values))


def main(arguments: list[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="high_bandwidth.search", description=SUMMARY)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--starts", type=int, default=4, help="drawn, about 15 s each")
    parser.add_argument("--trials", type=int, default=60, help="made from the best, about 4 s each")
    parser.add_argument("--light-mode-error", type=float, default=0.20)
    parser.add_argument("--model-itself", action="store_true",
                        help="let the model alone reach the demands, not every stage")
    parser.add_argument("--output", type=Path, default=Path("runs/high_bandwidth"),
                        help="directory of the file with the best start so far")
    options = parser.parse_args(arguments)
    demands = Demands(of_every_stage=not options.model_itself)
    demands = replace(demands, errors=replace(
        demands.errors, light_mode=options.light_mode_error))
    options.output.mkdir(parents=True, exist_ok=True)
    path = options.output / (
        f"search_{100 * options.light_mode_error:.0f}_"
        f"{'model' if options.model_itself else 'every_stage'}"
        f"_{options.seed}.json")
    begun_s = time.monotonic()

    def report(what: str, numbers: FloatArray, margin_db: float) -> None:
        print(f"{time.monotonic() - begun_s:6.0f} s  {what}: margin {margin_db:+.2f} dB",
              flush=True)
        path.write_text(json.dumps({
            "seed": options.seed, "starts": options.starts,
            "trials": options.trials, "demands": asdict(demands), "margin_db": margin_db,
            "start": asdict(search.as_start(numbers)),
            "resonances": search.as_resonances(numbers)}, indent=1), encoding="utf-8")

    search = Search(identified_stage(), demands)
    margin_db = search.run(options.seed, options.starts, options.trials, report)
    print(f"margin {margin_db:+.2f} dB, start in {path}")


if __name__ == "__main__":
    main()
