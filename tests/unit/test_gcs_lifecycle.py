"""The lifecycle's table: total, and loud where it has no answer."""

from __future__ import annotations

import itertools

import pytest

from skyrange.gcs import scripts
from skyrange.gcs.lifecycle import ARMED, CARRYING, OVER, TABLE, Event, LifecycleError, State, after


@pytest.mark.parametrize(("state", "event"), list(itertools.product(State, Event)))
def test_every_state_and_event_leads_somewhere_or_is_refused(state: State, event: Event) -> None:
    if event in TABLE[state]:
        assert after(state, event) is TABLE[state][event]
        return
    with pytest.raises(LifecycleError) as error:
        after(state, event, "blue/b1")
    assert "blue/b1" in str(error.value)
    assert event.value in str(error.value)
    assert state.value in str(error.value)
    for known in TABLE[state]:
        assert known.value in str(error.value)


def reachable(start: State) -> set[State]:
    seen, todo = {start}, [start]
    while todo:
        for state in TABLE[todo.pop()].values():
            if state not in seen:
                seen.add(state)
                todo.append(state)
    return seen


def test_every_state_is_reachable_and_every_flight_can_end() -> None:
    assert set(TABLE) == set(State)
    assert reachable(State.PLANNED) == set(State)
    for state in State:
        assert reachable(state) & OVER
        assert bool(TABLE[state]) is (state not in OVER)


def test_every_event_is_used_and_has_a_note() -> None:
    used = {event for row in TABLE.values() for event in row}
    assert used == set(Event) == set(scripts.NOTES)


def test_no_armed_state_fails_by_giving_up_without_coming_home() -> None:
    for state in ARMED - {State.ABORTING}:
        assert TABLE[state].get(Event.GAVE_UP) in (None, State.ABORTING)
    assert not ARMED & CARRYING
