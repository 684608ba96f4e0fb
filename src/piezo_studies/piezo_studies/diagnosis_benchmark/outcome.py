# SPDX-License-Identifier: BSD-3-Clause
"""Classify the result of each case, and count the results of all cases."""

from collections import Counter

import numpy as np

from piezo_studies.diagnosis_benchmark.effect_draws import CAUSES_OUTSIDE

CLEAR = 3.0
"""Smallest contribution, over the noise, of an effect that should be named first."""

AS_STRONG = 0.5
"""Either of two effects may be named first if their contributions have at least this ratio."""

ALSO_RIGHT = {"depolarisation": "gain_drift"}
"""Names that are also right for effects outside the list: depolarisation is a loss of gain."""

TARGETS = {
    "named_first_percent": (">=", 95.0),
    "false_alarms_percent": ("<=", 2.0),
    "outside_unexplained_percent": (">=", 90.0),
    "error_within_1.2_percent": (">=", 95.0),
}
ERROR_RATIO = 1.2


def strongest(result):
    """Return the causes that may be named first, and the contribution of the strongest over noise.

    The parameters and effects of a model explain part of an effect that was present during the
    identification. Only the remaining part counts, limited to the total error of the model.
    """
    found = result["contributions"]
    if result["model"] == "identified before":
        size, bound = "over_noise", np.inf
    else:
        size, bound = "beyond_model_over_noise", result["lacking_over_noise"]
    most = max((entry[size] for entry in found), default=0.0)
    return [entry["cause"] for entry in found if entry[size] >= AS_STRONG * most], min(most, bound)


def refused(case, error):
    """Return the result of a case that could not be diagnosed."""
    return {"number": case.number, "plant": case.plant, "kind": case.kind,
            "causes": list(case.causes), "verdict": "refused", "error": str(error)}


def _group_of_refused(result):
    causes = set(result["causes"])
    return "outside" if causes & CAUSES_OUTSIDE.keys() else "clear" if causes else "clean"


def outcome(result):
    """Return the group of a case, "clean", "outside", "clear" or "weak", and how its result counts.

    The group follows from the contribution. The first name is right only if all further named
    effects are present.
    """
    if result["verdict"] == "refused":
        return _group_of_refused(result), "refused"
    causes, most = strongest(result)
    first = result["effects"][0] if result["effects"] else None
    if not causes:
        return "clean", "right" if result["verdict"] == "none" else "false alarm"
    if set(causes) & CAUSES_OUTSIDE.keys():
        is_right = result["verdict"] == "unexplained" or any(
            first is not None and ALSO_RIGHT.get(cause) == first for cause in causes)
        return "outside", "right" if is_right else result["verdict"]
    group = "clear" if most > CLEAR else "weak"
    if first in causes and not set(result["effects"]) <= {
            entry["cause"] for entry in result["contributions"]}:
        return group, "wrong beside"
    if first in causes or result["verdict"] == "none" and set(causes) <= set(result["in_model"]):
        return group, "right"
    if set(causes) & set(result["not_decidable"]):
        return group, "not decidable"
    return group, "wrong" if first else "no name"


def summary(results):
    """Return the figures with their targets, the confusion table and the outcomes."""
    counted: dict[str, Counter[str]] = {
        group: Counter() for group in ("clear", "weak", "clean", "outside")}
    confusion: dict[str, Counter[str]] = {}
    of_perfect: list[float] = []
    for result in results:
        group, what = outcome(result)
        counted[group][what] += 1
        if result["verdict"] == "explained" and group == "clear" and "perfect_um" in result:
            of_perfect.append(result["after_um"] / result["perfect_um"])
        if result["verdict"] == "refused":
            row, named = (*result["causes"], "clean")[0], "refused"
        elif group in ("clean", "outside"):
            row, named = group, result["verdict"]
        else:
            causes, _ = strongest(result)
            row = next((name for name in result["effects"][:1] if name in causes), causes[0])
            named = result["effects"][0] if result["effects"] else result["verdict"]
        if group != "weak":
            confusion.setdefault(row, Counter())[named] += 1
    clear = counted["clear"]
    decidable = clear.total() - clear["not decidable"]
    ratios = np.array(of_perfect)
    return {
        "figures": {
            "named_first_percent": _percent(clear["right"], decidable),
            "named_first_of_all_percent": _percent(clear["right"], clear.total()),
            "false_alarms_percent": _percent(counted["clean"]["false alarm"],
                                             counted["clean"].total()),
            "outside_unexplained_percent": _percent(counted["outside"]["right"],
                                                    counted["outside"].total()),
            "error_within_1.2_percent": _percent(int(np.sum(ratios <= ERROR_RATIO)), ratios.size),
            "error_ratio_median": float(np.median(ratios)) if ratios.size else None,
        },
        "targets": {name: " ".join(map(str, target)) for name, target in TARGETS.items()},
        "outcomes": {group: dict(sorted(counts.items())) for group, counts in counted.items()},
        "confusion": {row: dict(sorted(counts.items()))
                      for row, counts in sorted(confusion.items())},
    }


def without_experiments(result):
    """Return the result of a case before any proposed recording was made."""
    return {**result, **result.get("before_experiments", {})}


def _percent(part, whole):
    return 100.0 * part / whole if whole else None


def as_text(document):
    """Return the summary as text."""
    lines = ["what was there -> most probable effect (contributions above "
             f"{CLEAR:g} x noise; clean and outside the list: the verdict)"]
    for row, counts in document["confusion"].items():
        named = ", ".join(f"{name} {count}" for name, count in
                          sorted(counts.items(), key=lambda item: -item[1]))
        lines.append(f"  {row:26s} {named}")
    for title, outcomes in (("outcomes before any experiment", document.get("outcomes_before")),
                            ("outcomes", document["outcomes"])):
        if outcomes is None:
            continue
        lines.append(title)
        for group, counts in outcomes.items():
            text = ", ".join(f"{name} {count}" for name, count in counts.items())
            lines.append(f"  {group:26s} {text}")
    lines.append("figures")
    for name, value in document["figures"].items():
        shown = "-" if value is None else f"{value:.4g}"
        lines.append(f"  {name:30s} {shown:>8s}   {document['targets'].get(name, '')}")
    return "\n".join(lines)
