# SPDX-License-Identifier: BSD-3-Clause
"""Work that is done side by side: its order, its ends, and that a diagnosis is the same by it."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from piezo_common import side_by_side as module
from piezo_common.cancellation import check_cancelled, checking
from piezo_common.side_by_side import side_by_side


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_results_and_reports_come_in_the_order_of_the_items(threads):
    told = []
    assert side_by_side(str, range(20), told.append, threads) == [str(n) for n in range(20)]
    assert told == list(range(20))


def test_two_items_are_under_way_at_once():
    both = threading.Barrier(2, timeout=300.0)
    assert len(side_by_side(lambda item: both.wait(), range(2), threads=2)) == 2


@pytest.mark.parametrize("threads", [1, 2])
def test_what_an_item_raises_reaches_the_caller(threads):
    def work(item):
        if item == 3:
            raise ValueError("the fourth")
        return item

    with pytest.raises(ValueError, match="the fourth"):
        side_by_side(work, range(5), threads=threads)


@pytest.mark.parametrize("threads", [1, 2])
def test_what_ends_the_callers_work_ends_that_of_the_items(threads):
    class Ended(Exception):
        pass

    def end():
        raise Ended

    with checking(end), pytest.raises(Ended):
        side_by_side(lambda item: check_cancelled(), range(3), threads=threads)


def test_ctrl_c_leaves_what_has_not_begun(monkeypatch):
    begun, cancelled = [], threading.Event()

    class Pool(ThreadPoolExecutor):
        def shutdown(self, **options):
            super().shutdown(**options | {"wait": False})
            cancelled.set()
            super().shutdown()

    def work(item):
        begun.append(item)
        assert cancelled.wait(30.0)

    def interrupted(number):
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "ThreadPoolExecutor", Pool)
    with pytest.raises(KeyboardInterrupt):
        side_by_side(work, range(1000), interrupted, 2)
    assert len(begun) <= 2


def test_work_within_work_takes_no_more_threads(monkeypatch):
    monkeypatch.setattr(module, "cores", lambda: 2)

    def work(item):
        inner = side_by_side(lambda part: threading.get_ident(), range(20))
        return set(inner) == {threading.get_ident()}

    assert all(side_by_side(work, range(4)))
    assert side_by_side(lambda item: threading.get_ident(), [0]) == [threading.get_ident()]


def test_there_is_a_thread_for_each_core_up_to_a_limit(monkeypatch):
    for cores, most in ((1, 1), (2, 2), (64, module.MOST_THREADS)):
        monkeypatch.setattr(module, "cores", lambda cores=cores: cores)
        used = set()
        side_by_side(lambda item, used=used: used.add(threading.get_ident()), range(200))
        assert len(used) <= most
