# SPDX-License-Identifier: BSD-3-Clause
"""What is advised about an order, from tables of orders made by hand."""

import pytest

from piezo_identification.adequacy.order_advice import advice_on_creep_pairs, advice_on_order
from piezo_identification.estimators.estimate import Estimate, OrderTrial


def estimate(*trials, order=1, order_given=False):
    return Estimate(None, {}, order, tuple(
        OrderTrial(number, 4 + 2 * number, left, -1.0, refusal)
        for number, left, refusal in trials), order_given)


def test_no_order_is_named_that_leaves_as_much():
    advice = advice_on_order(estimate((1, 0.50, ""), (2, 0.49, ""), (3, 0.48, "a mode above")))
    assert advice == ("keep order 1, as none of the 2 others that were tried leaves clearly less "
                      "(the least is 0.48 um)")


@pytest.mark.parametrize("refusal", ["", "a mode without damping"])
def test_an_order_that_leaves_less_is_named_with_what_speaks_against_it(refusal):
    advice = advice_on_order(estimate((1, 0.50, ""), (2, 0.20, refusal), (3, 0.49, "")))
    assert "where 2 leaves least: 0.2 um of 0.5 um" in advice
    assert advice.endswith(f"but has {refusal}" if refusal else "0.5 um")


def test_where_the_order_was_asked_for_it_is_to_be_sought():
    assert advice_on_order(estimate((1, 0.5, ""), order_given=True)).startswith("leave --modes out")
    assert advice_on_order(estimate((1, 0.5, ""))) == ""


def test_no_number_of_creep_pairs_is_advised_that_was_tried():
    rejected = estimate((0, 2.0, ""), (1, 0.5, ""), (2, 0.5, "a gain is not positive"))
    assert advice_on_creep_pairs(rejected) == ""
    ended = estimate((0, 2.0, ""), (1, 0.5, ""), (2, 0.3, ""), order=2)
    assert advice_on_creep_pairs(ended) == "ask for --creep-pairs 3"
    asked = estimate((0, 2.0, ""), (1, 0.5, ""), order_given=True)
    assert advice_on_creep_pairs(asked).startswith("leave --creep-pairs out")
