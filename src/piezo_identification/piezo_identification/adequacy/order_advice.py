# SPDX-License-Identifier: BSD-3-Clause
"""What to do about creep or dynamics that are inadequate, from the orders that were tried."""

from piezo_identification.estimators.estimate import Estimate, OrderTrial

CLEARLY_LESS = 0.9
"""An order leaves clearly less than another if its residual is below this part of the other's."""


def advice_on_order(estimate: Estimate) -> str:
    """Say which order to ask for, or that none helps.

    Parameters
    ----------
    estimate : Estimate
        Of the dynamics, with all its trials.

    Returns
    -------
    str
        Empty where a single order was tried by choice of the method.
    """
    if estimate.order_given:
        return "leave --modes out, so that the order is sought"
    others = [trial for trial in estimate.trials if trial.order != estimate.order]
    if not others:
        return ""
    least = min(others, key=_left)
    if least.residual_rms > CLEARLY_LESS * estimate.residual_rms:
        return (f"keep order {estimate.order}, as none of the {len(others)} others that were tried "
                f"leaves clearly less (the least is {least.residual_rms:.3g} um)")
    refusal = f", but has {least.refusal}" if least.refusal else ""
    return (f"see the table of orders, where {least.order} leaves least: "
            f"{least.residual_rms:.3g} um of {estimate.residual_rms:.3g} um{refusal}")


def advice_on_creep_pairs(estimate: Estimate) -> str:
    """Say which number of creep pairs to ask for, where one was not tried.

    Parameters
    ----------
    estimate : Estimate
        Of the creep, with all its trials.

    Returns
    -------
    str
        Empty where the next larger number was tried and left out.
    """
    if estimate.order_given:
        return "leave --creep-pairs out, so that their number is sought"
    further = estimate.order + 1
    if any(trial.order >= further for trial in estimate.trials):
        return ""
    return f"ask for --creep-pairs {further}"


def _left(trial: OrderTrial) -> float:
    return trial.residual_rms
