# SPDX-License-Identifier: BSD-3-Clause
"""Calibration of the probabilities of verdicts: reliability and expected calibration error.

The most probable statement of each case is evaluated, as in Guo et al. (2017), "On calibration of
modern neural networks".
"""

from dataclasses import dataclass

import numpy as np

from piezo_identification.diagnosis.joint.probabilities import NONE, SOMETHING_ELSE
from piezo_studies.diagnosis_benchmark.outcome import CLEAR, outcome, strongest

BINS = 10
DRAWS, SEED = 4000, 0
"""Number of simulated outcomes of a calibrated program, which gives their mean to 0.001, and their
seed."""


@dataclass(frozen=True)
class Reliability:
    """How often statements of a given probability are true."""

    edges: tuple
    """Edges of the bins of probability, (B + 1,)."""
    stated: tuple
    true: tuple
    """Mean probability and fraction of true statements in each bin, (B,); None in an empty bin."""
    counts: tuple
    """Number of statements in each bin, (B,)."""
    expected_calibration_error: float
    """Mean distance of the two, weighted by the counts."""
    calibrated_mean: float
    calibrated_most: float
    """Mean and 95 % quantile of this error for a perfectly calibrated program with the same
    cases."""

    def document(self):
        """Return the reliability as plain values."""
        return {"bins": [
            {"from": low, "to": high, "stated": stated, "true": true, "cases": count}
            for low, high, stated, true, count in zip(
                self.edges[:-1], self.edges[1:], self.stated, self.true, self.counts, strict=True)
        ], "expected_calibration_error": self.expected_calibration_error,
            "of_a_calibrated_program": {"mean": self.calibrated_mean,
                                        "most": self.calibrated_most}}

    def sentence(self):
        """Return the error as text, with that of a calibrated program for the same cases."""
        return (f"expected calibration error {self.expected_calibration_error:.3f}; of a "
                f"calibrated program {self.calibrated_mean:.3f}, and in 95 of 100 runs at most "
                f"{self.calibrated_most:.3f}")


def is_true(result, label, strict=False):
    """Return whether a statement of a diagnosis is true in a case.

    A set of effects is true if all its effects are present, including a strongest one. "None" is
    true if no effect is present, or none is clear. "Something else" is true if the cause is outside
    the list, or, unless `strict`, if it is named but differs in form from the effect in the list.
    """
    group, _ = outcome(result)
    if label == NONE:
        if strongest(result)[1] <= CLEAR:
            return True
        held = set(result["in_model"])
        causes = {entry["cause"] for entry in result["contributions"]}
        return group in ("clean", "weak") or bool(causes) and causes <= held
    causes, _ = strongest(result)
    if label == SOMETHING_ELSE:
        return group == "outside" or not strict and bool(set(causes) & set(result["effects"]))
    names = set(label.split("+"))
    return names <= {entry["cause"] for entry in result["contributions"]} and bool(
        names & set(causes))


def first_statements(results, strict=False):
    """Return the largest probability of each case, (n,), and whether its statement is true."""
    weighed = [result for result in results if result.get("probabilities")]
    first = [max(result["probabilities"], key=result["probabilities"].get) for result in weighed]
    return (np.array([result["probabilities"][label]
                      for result, label in zip(weighed, first, strict=True)]),
            np.array([is_true(result, label, strict)
                      for result, label in zip(weighed, first, strict=True)], dtype=bool))


def reliability(probabilities, true, bins=BINS):
    """Return how often statements, (n,), are true, in bins of their probability."""
    probabilities = np.asarray(probabilities, dtype=float)
    edges = np.linspace(0.0, 1.0, bins + 1)
    number = np.minimum((probabilities * bins).astype(int), bins - 1)
    counts = np.bincount(number, minlength=bins)
    stated, occurred = (np.bincount(number, values, bins)
                        for values in (probabilities, np.asarray(true, dtype=float)))
    random = np.random.default_rng(SEED)
    of_calibrated = []
    for _ in range(DRAWS):
        comes_true = random.random(number.size) < probabilities
        of_calibrated.append(_error(stated, np.bincount(number, comes_true, bins), counts))
    return Reliability(
        tuple(edges.tolist()), _means(stated, counts), _means(occurred, counts),
        tuple(counts.tolist()), _error(stated, occurred, counts),
        float(np.mean(of_calibrated)), float(np.quantile(of_calibrated, 0.95)))


def _error(stated, occurred, counts):
    """Return the calibration error from sums of probabilities and of true statements per bin."""
    return float(np.sum(np.abs(stated - occurred)) / max(1, np.sum(counts)))


def _means(sums, counts):
    return tuple(float(each / count) if count else None
                 for each, count in zip(sums, counts, strict=True))


def draw_reliability(axes, found):
    """Draw the reliability diagram: fraction of true statements over their probability."""
    shown = [(stated, true, count) for stated, true, count in zip(
        found.stated, found.true, found.counts, strict=True) if count]
    stated, true, counts = (np.array(part) for part in zip(*shown, strict=True))
    axes.plot([0.0, 1.0], [0.0, 1.0], linestyle="--", label="calibrated")
    # Error bars are standard deviations of a binomial fraction.
    spread = np.sqrt(stated * (1.0 - stated) / counts)
    axes.errorbar(stated, true, yerr=spread, fmt="o", label="cases")
    for x, y, count in shown:
        axes.annotate(str(count), (x, y), textcoords="offset points", xytext=(6, -10))
    axes.set(xlabel="probability stated", ylabel="share that is true", xlim=(0.0, 1.02),
             ylim=(-0.02, 1.05))
    axes.legend()


def calibrate(results, strict=False):
    """Return the calibration of a table of cases; for `strict` see `is_true`."""
    return reliability(*first_statements(results, strict))
