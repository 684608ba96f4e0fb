# SPDX-License-Identifier: BSD-3-Clause
import contextlib
import threading

from piezo_stage_driver.safety.open_answers import OpenAnswers


class Meeting(int):
    """A number to which two threads add at the same moment, if they are let."""

    both = threading.Barrier(2)

    def __add__(self, other):
        with contextlib.suppress(threading.BrokenBarrierError):
            self.both.wait(0.5)
        return Meeting(int(self) + other)


def test_answers_that_begin_in_two_threads_at_once_are_both_counted():
    answers = OpenAnswers()
    answers._open = Meeting(0)
    threads = [threading.Thread(target=answers.begin) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    answers.end()
    assert not answers.none
    answers.end()
    assert answers.none
