# SPDX-License-Identifier: BSD-3-Clause
"""Answers are counted between bounds, late ones too, and strangers never."""

from piezo_stage_driver.engine.answer_latency import BOUNDS_MS, AnswerLatency


def test_every_latency_is_counted_once_at_its_bound():
    latency = AnswerLatency()
    for latency_ms in (0.1, 0.2, 0.3, 1.0, 70.0, 101.0, 5000.0):
        latency.add(latency_ms)
    assert latency.counts == [2, 1, 1, 0, 0, 0, 0, 0, 1, 2]
    described = latency.described("answers", "longest_answer_ms")
    assert described["answers_within_0.2_ms"] == 2
    assert described["answers_beyond_100_ms"] == 2
    assert described["longest_answer_ms"] == "5000.000"
    assert len(latency.counts) == len(BOUNDS_MS) + 1


def test_late_answers_count_and_answers_to_nothing_do_not():
    latency = AnswerLatency()
    for tick in range(5, 15):
        latency.published(tick)
    for tick in (5, 14, 3, 5 + 1024):
        latency.answered(tick)
    assert sum(latency.counts) == 2
