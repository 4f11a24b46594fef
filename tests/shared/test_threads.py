# SPDX-License-Identifier: Apache-2.0
"""`Threads` return what a function returns for each item, in the items' order, and end with the
first error.
"""

import threading

import pytest

from coincid.model.shared.threads import Threads


@pytest.mark.parametrize("number", [1, 2, 5, None])
@pytest.mark.parametrize("items", [0, 1, 3, 100])
def test_results_are_in_the_order_of_the_items(number, items):
    with Threads(number) as threads:
        for _ in range(3):  # the same threads again
            assert threads.map(lambda item: item * item, range(items)) == [
                item * item for item in range(items)
            ]


def test_items_are_shared_by_as_many_threads_as_wanted():
    together = threading.Barrier(3, timeout=60)
    with Threads(3) as threads:
        names = threads.map(
            lambda _: (together.wait(), threading.current_thread().name)[1], range(3)
        )
    assert len(set(names)) == 3 and threading.current_thread().name in names


@pytest.mark.parametrize(("number", "cores"), [(1, 8), (None, 1), (None, None)])
def test_one_thread_is_the_callers(number, cores, monkeypatch):
    """Also where the number of cores is not known."""
    monkeypatch.setattr("os.cpu_count", lambda: cores)
    both = threading.Barrier(2)

    def alone(_):
        with pytest.raises(threading.BrokenBarrierError):
            both.wait(timeout=0.2)  # for another thread
        return threading.current_thread()

    with Threads(number) as threads:
        assert set(threads.map(alone, range(2))) == {threading.current_thread()}


@pytest.mark.parametrize("number", [1, 4])
def test_error_reaches_the_caller_and_nothing_new_begins(number):
    begun = []

    def work(item):
        begun.append(item)
        raise ZeroDivisionError

    with Threads(number) as threads, pytest.raises(ZeroDivisionError):
        threads.map(work, range(1000))
    assert len(begun) <= number


def test_an_error_of_another_thread_reaches_the_caller():
    """Also if all items of the caller's own thread went well."""
    caller = threading.current_thread()
    together = threading.Barrier(2, timeout=60)

    def work(item):
        together.wait()  # so each thread has one of the items
        if threading.current_thread() is not caller:
            raise ZeroDivisionError

    with Threads(2) as threads, pytest.raises(ZeroDivisionError):
        threads.map(work, range(2))
