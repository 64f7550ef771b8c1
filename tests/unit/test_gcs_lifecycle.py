"""The lifecycle's table: total, and loud where it has no answer."""

from __future__ import annotations

import itertools

import pytest

from skyrange.gcs.flight import procedures
from skyrange.gcs.flight.lifecycle import (
    ARMED,
    ENDED,
    TRANSFERRING,
    TRANSITIONS,
    FlightEvent,
    FlightState,
    LifecycleError,
    next_state,
)
from tests.cases import each_case


@each_case("state, event", list(itertools.product(FlightState, FlightEvent)))
def test_every_state_and_event_leads_somewhere_or_is_refused(state: FlightState, event: FlightEvent) -> None:
    if event in TRANSITIONS[state]:
        assert next_state(state, event) is TRANSITIONS[state][event]
        return
    with pytest.raises(LifecycleError) as error:
        next_state(state, event, "blue/b1")
    assert "blue/b1" in str(error.value)
    assert event.value in str(error.value)
    assert state.value in str(error.value)
    for known in TRANSITIONS[state]:
        assert known.value in str(error.value)


def reachable(start: FlightState) -> set[FlightState]:
    seen, todo = {start}, [start]
    while todo:
        for state in TRANSITIONS[todo.pop()].values():
            if state not in seen:
                seen.add(state)
                todo.append(state)
    return seen


def test_every_state_is_reachable_and_every_flight_can_end() -> None:
    assert set(TRANSITIONS) == set(FlightState)
    assert reachable(FlightState.PLANNED) == set(FlightState)
    for state in FlightState:
        assert reachable(state) & ENDED
        assert bool(TRANSITIONS[state]) is (state not in ENDED)


def test_every_event_is_used_and_has_a_note() -> None:
    used = {event for row in TRANSITIONS.values() for event in row}
    assert used == set(FlightEvent) == set(procedures.EVENT_NOTES)


def test_no_armed_state_fails_by_giving_up_without_coming_home() -> None:
    for state in ARMED - {FlightState.ABORTING}:
        assert TRANSITIONS[state].get(FlightEvent.GAVE_UP) in (None, FlightState.ABORTING)
    assert not ARMED & TRANSFERRING
