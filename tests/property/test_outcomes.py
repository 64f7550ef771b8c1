"""Outcomes in a record: a crash in truth is never a complete mission, whatever a ground station reports."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.contracts.mailboxes import Note
from skyrange.record import Recorder, load
from skyrange.record.notes import outcomes_of_events
from skyrange.record.write.memory_observer import MemoryObserver
from tests.unit.record_sample import HEADER, MS, VEHICLES

REPORTS = [Note("event.outcome", "", {"state": state, "reason": ""}) for state in ("complete", "failed")]
CRASH = Note("event.crash", "", {"tilt_deg": 90.0, "speed_mps": 9.0})
NOTES = st.lists(
    st.builds(
        lambda vehicle, note: Note(note.kind, vehicle, note.data),
        st.sampled_from(VEHICLES),
        st.sampled_from([*REPORTS, CRASH, Note("event.landed", "", {})]),
    ),
    max_size=8,
)


def expected(notes: list[Note], vehicle: str) -> str:
    """By the rule in words, over all notes at once."""
    states = [note.data["state"] for note in notes if note.about == vehicle and note.kind == "event.outcome"]
    crashed = any(note.about == vehicle and note.kind == "event.crash" for note in notes)
    last = states[-1] if states else "unfinished"
    return "failed" if crashed and last == "complete" else str(last)


@given(NOTES)
def test_a_crash_is_never_complete_before_or_after_the_report(notes: list[Note]) -> None:
    rows = [(number * MS, note.kind, note.about, note.data) for number, note in enumerate(notes)]
    found = outcomes_of_events(VEHICLES, rows)
    assert {vehicle: entry["state"] for vehicle, entry in found.items()} == {
        vehicle: expected(notes, vehicle) for vehicle in VEHICLES
    }
    for entry in found.values():
        assert ("reported complete" in entry["reason"]) is (entry["reason"] != "")


@settings(deadline=None, max_examples=12)
@given(NOTES)
def test_every_way_to_record_a_run_knows_of_the_crash(notes: list[Note]) -> None:
    """A closed record, one that was killed, and one in memory."""
    with TemporaryDirectory() as scratch:
        closed, killed = (Recorder.open(Path(scratch) / name, HEADER) for name in ("closed", "killed"))
        memory = MemoryObserver()
        for number, note in enumerate(notes):
            for observer in (closed, killed, memory):
                observer.on_note(number * MS, "world", note)
        closed.close()
        killed.flush()
        found = load(Path(scratch) / "closed").outcomes
        assert {vehicle: entry["state"] for vehicle, entry in found.items()} == {
            vehicle: expected(notes, vehicle) for vehicle in VEHICLES
        }
        assert load(Path(scratch) / "killed").outcomes == found
        killed.close()
        assert memory.outcomes == {vehicle: entry for vehicle, entry in found.items() if entry["state"] != "unfinished"}
