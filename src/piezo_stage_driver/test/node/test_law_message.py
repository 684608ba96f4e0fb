# SPDX-License-Identifier: BSD-3-Clause
"""A law that is sent to the stage is the law that arrives."""

import array

import numpy as np
import pytest

from piezo_models.feedback_law.feedback_law import (
    DeclaredPlant,
    FeedbackLaw,
    FeedbackLawError,
    LinearBlock,
)
from piezo_ros.stage_runs.law_message import message_of
from piezo_stage_driver.node.law_of_message import law_of

ROWS = np.arange(10.0).reshape(5, 2)
PUSH, READ = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]), np.array([[7.0, 8, 9], [10, 11, 12]])


@pytest.fixture
def law():
    block = LinearBlock(0.5 * np.eye(3), PUSH, READ, np.zeros((2, 2)))
    tick = LinearBlock(0.5 * np.eye(3), PUSH, READ, ROWS[:2])
    return FeedbackLaw(tick, PUSH, 5.0, ROWS, ROWS[:3], DeclaredPlant(block, ROWS[1:]), 7, 1,
                       max_error_um=2.0, fade_samples=3, axes=("x", "y"))


def test_law_of_two_axes_arrives_as_it_was_sent(law):
    arrived = law_of(message_of(law))
    for sent, block in ((law.tick, arrived.tick), (law.plant.linear, arrived.plant.linear)):
        assert all(np.array_equal(getattr(block, part), getattr(sent, part)) for part in "abcd")
    for name in ("observer", "once_um", "period_um"):
        assert np.array_equal(getattr(arrived, name), getattr(law, name))
    assert np.array_equal(arrived.plant.gains_um_per_v, ROWS[1:])
    assert arrived.sample.empty and arrived.inverse is None
    for name in ("axes", "start_sample", "delay_ticks", "max_error_um", "fade_samples"):
        assert getattr(arrived, name) == getattr(law, name)


def test_law_of_one_axis_keeps_the_fields_of_several_empty():
    block = LinearBlock.of([0.5], [1.0], [2.0], [0.0])
    message = message_of(FeedbackLaw(
        LinearBlock.of([1.0], [0.1], [1.0], [0.3]), np.array([0.2]), 5.0, np.zeros(4), np.zeros(2),
        DeclaredPlant(block, np.array([0.4]))))
    assert (message.tick.d, message.tick.inputs, message.tick.outputs) == (0.3, 0, 0)
    assert not message.tick.direct and not message.axes
    arrived = law_of(message)
    assert (arrived.tick.d, arrived.axes, arrived.once_um.shape) == (0.3, (), (4,))


def test_message_whose_parts_do_not_fit_is_refused(law):
    message = message_of(law)
    message.observer = array.array("d", [1.0] * 5)
    with pytest.raises(FeedbackLawError, match="5 elements for 2 axes"):
        law_of(message)
    message = message_of(law)
    message.tick.outputs = 1
    with pytest.raises(FeedbackLawError, match="has 2 inputs and 1 outputs"):
        law_of(message)
