# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from piezo_recorder.sample_block import SampleCount, block_span


@settings(deadline=None)
@given(
    first_sample=st.integers(0, 2**63), samples=st.integers(0, 100),
    frame_id=st.text("abc/", max_size=20), stride=st.integers(1, 40_000))
def test_the_span_is_that_of_the_serialised_block(
        sample_blocks, first_sample, samples, frame_id, stride):
    data = sample_blocks.serialise(
        first_sample, np.zeros(samples), np.zeros(samples), stride / 40_000, frame_id=frame_id)
    assert block_span(data) == (first_sample, stride / 40_000, samples)


def test_samples_and_gaps_are_counted_on_the_sample_clock(sample_blocks):
    count = SampleCount()
    assert count.missing_until(9) == 10
    for first_sample, samples, period_s in ((100, 10, 2.5e-5), (130, 5, 5e-5)):
        count.add(sample_blocks.serialise(
            first_sample, np.zeros(samples), np.zeros(samples), period_s))
    assert (count.samples, count.missing, count.end) == (15, 20, 140)
    assert count.missing_until(139) == 0
    assert count.missing_until(141) == 2


@pytest.mark.parametrize("sample_rate_hz", [10_000.0, 40_000.0, 80_000.0])
def test_the_count_follows_the_rate_of_the_clock(sample_blocks, sample_rate_hz):
    count = SampleCount(sample_rate_hz)
    count.add(sample_blocks.serialise(0, np.zeros(7), np.zeros(7), 3 / sample_rate_hz))
    assert count.end == 21
