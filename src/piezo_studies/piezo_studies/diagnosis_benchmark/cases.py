# SPDX-License-Identifier: BSD-3-Clause
"""The cases: hidden effects, their strengths, plants and recordings."""

from dataclasses import dataclass

import numpy as np

from piezo_studies.diagnosis_benchmark import records
from piezo_studies.diagnosis_benchmark.effect_draws import CAUSES, CAUSES_OUTSIDE

CLEAN_SHARE, OUTSIDE_SHARE, PAIRS_SHARE = 40 / 260, 20 / 260, 52 / 260
CASES_PER_PLANT = 10
WEAKEST, STRONGEST = 1.2, 40.0
"""Smallest and largest contribution of an effect to the recording, over the noise."""
WEAKEST_ALONG, STRONGEST_ALONG = 10.0, 120.0
"""The same for effects present during the identification; the model's parameters compensate most of
them."""
OUTSIDE_WEAKEST = 6.0
"""Smallest contribution of an effect outside the list, over the noise."""
LATER_SHARE = 0.7
"""Fraction of cases in which the effect appeared after the identification."""

FAST_ONLY, SLOW_ONLY = {"vibration_mode", "slew_limit"}, {"thermal_drift"}
"""Effects that a slow logger cannot record, and effects that need more than a fast recording."""

LATER_ONLY = {"slew_limit"}
"""Effects whose presence during the identification prevents a usable model."""


@dataclass(frozen=True)
class Case:
    """One case, which is determined by seed and number."""

    number: int

    seed: int
    """Seed of the whole suite."""
    plant: int
    """Number of its plant."""
    causes: tuple
    """Hidden effects, as keys of `CAUSES` or `CAUSES_OUTSIDE`; empty if there are none."""
    multiples: tuple
    """Contribution of each effect, over the noise."""
    kind: str
    """Kind of the recording, a key of `records.KINDS`."""
    slow: bool
    """Whether it is recorded by a slow logger for tens of seconds."""
    later: bool
    """Whether the effects appeared after the identification."""

    @property
    def outside(self):
        """Whether an effect outside the list is present."""
        return any(cause in CAUSES_OUTSIDE for cause in self.causes)

    def random(self, purpose):
        """Return the random generator for one purpose."""
        return np.random.default_rng([self.seed, self.number, *purpose.encode()])


def draw_cases(count, seed):
    """Draw cases in the proportions of the suite, in random order."""
    random = np.random.default_rng([seed, *b"cases"])
    clean, outside, pairs = (
        round(count * share) for share in (CLEAN_SHARE, OUTSIDE_SHARE, PAIRS_SHARE)
    )
    causes: list[tuple[str, ...]] = [()] * clean
    causes += [(name,) for name in _in_turn(list(CAUSES_OUTSIDE), outside, random)]
    causes += [(name, _another(name, random)) for name in _in_turn(list(CAUSES), pairs, random)]
    causes += [(name,) for name in _in_turn(list(CAUSES), count - len(causes), random)]
    kinds = _kinds(count, random)
    cases = []
    for number, index in enumerate(random.permutation(count)):
        chosen, (kind, slow) = causes[index], kinds[number]
        if FAST_ONLY.intersection(chosen) or SLOW_ONLY.intersection(chosen):
            slow = bool(SLOW_ONLY.intersection(chosen))
        weakest = OUTSIDE_WEAKEST if CAUSES_OUTSIDE.keys() & set(chosen) else WEAKEST
        multiples = np.exp(random.uniform(np.log(weakest), np.log(STRONGEST), len(chosen)))
        cases.append(Case(
            number, seed, number // CASES_PER_PLANT, chosen, tuple(map(float, multiples)), kind,
            slow, bool(random.random() < LATER_SHARE or LATER_ONLY & set(chosen)),
        ))
    return cases


def draw_cases_all_along(count, seed):
    """Draw cases with one strong effect that was present during the identification."""
    random = np.random.default_rng([seed, *b"all along"])
    causes = _in_turn([name for name in CAUSES if name not in LATER_ONLY], count, random)
    kinds = _kinds(count, random)
    cases = []
    for number, (cause, (kind, slow)) in enumerate(zip(causes, kinds, strict=True)):
        if cause in FAST_ONLY | SLOW_ONLY:
            slow = cause in SLOW_ONLY
        multiple = np.exp(random.uniform(np.log(WEAKEST_ALONG), np.log(STRONGEST_ALONG)))
        cases.append(Case(number, seed, number // CASES_PER_PLANT, (cause,), (float(multiple),),
                          kind, slow, later=False))
    return cases


def _kinds(count, random):
    """Return `count` pairs of a kind of recording and whether its logger is slow."""
    return _in_turn([(kind, slow) for kind in records.KINDS for slow in (False, True)],
                    count, random)


def _in_turn(items, count, random):
    """Return `count` items in random order, all equally often."""
    rounds = -(-count // len(items)) if items else 0
    taken = [items[i] for _ in range(rounds) for i in random.permutation(len(items))]
    return taken[:count]


def _another(name, random):
    """Draw a second effect that can be recorded together with the first."""
    apart = (FAST_ONLY if name in SLOW_ONLY else SLOW_ONLY if name in FAST_ONLY else set())
    return str(random.choice([other for other in CAUSES if other not in apart | {name}]))
