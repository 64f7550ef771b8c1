"""Python's garbage collector is at ease within a run only, and finds what a run leaves."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Iterator

import pytest

from skyrange.runtime.memory import collect_seldom


class Knot:
    """An object that only the collector can free."""

    def __init__(self) -> None:
        self.me = self


@pytest.fixture(autouse=True)
def _pythons_own_threshold() -> Iterator[None]:
    """A command that ran in this process has made the collector less frequent for good."""
    before = gc.get_threshold()
    gc.set_threshold(700, *before[1:])
    yield
    gc.set_threshold(*before)


def test_everything_is_as_before_afterwards_even_where_it_breaks() -> None:
    before = gc.get_threshold(), gc.get_freeze_count()
    with collect_seldom():
        assert gc.get_threshold()[0] > before[0][0]
        assert gc.get_freeze_count() > 0
        with collect_seldom():
            pass
        assert gc.get_freeze_count() > 0, "an inner one leaves what the outer one set apart"
    assert (gc.get_threshold(), gc.get_freeze_count()) == before
    with pytest.raises(ZeroDivisionError), collect_seldom():
        _ = 1 // 0
    assert (gc.get_threshold(), gc.get_freeze_count()) == before


def test_garbage_of_the_flight_is_found_in_the_flight() -> None:
    with collect_seldom():
        knot = Knot()
        gone = weakref.ref(knot)
        del knot
        gc.collect()
        assert gone() is None
