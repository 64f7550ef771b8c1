"""The terminal of a flight shows every mishap and all acts, whatever names they have, on terminals of any width."""

from __future__ import annotations

import io
import itertools
import json
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from unicodedata import category

import numba
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba.core import event
from rich.cells import cell_len
from rich.console import Console, Group, RenderableType

from skyrange.assembly.build import Additions
from skyrange.cli.output import progress as progress_module
from skyrange.cli.output.escaping_console import EscapingConsole
from skyrange.cli.output.flight_bar import COMPILING, FlightBar
from skyrange.cli.output.flight_lines import MAX_EVENTS, MAX_GROUPS, MAX_OBSERVED, FlightLines, GroupLines
from skyrange.cli.output.progress import flight_progress
from skyrange.contracts.alerts import Alert
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.verdicts import Label
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_S, to_seconds
from skyrange.metrics.safety import describe_mishap, distinct_mishaps
from skyrange.metrics.time_series import read_notes
from skyrange.record import RunRecord
from skyrange.runtime.compilation.in_flight import Compilations, watch_compilations
from skyrange.runtime.event_reports import (
    MAX_ROWS,
    AircraftState,
    EventCollector,
    EventReport,
    describe_report,
)
from skyrange.runtime.live.transport.control import MAX_MESSAGE_BYTES, pack_message
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load as load_scenario
from skyrange.study.execution.executors import GroupEvents
from skyrange.study.runs import fly
from tests.flights import shared_run

pytestmark = pytest.mark.rotating

texts = st.text(max_size=300)
times = st.integers(0, 10**12)
kinds = st.sampled_from(
    ["event.takeoff", "event.contact", "event.crash", "event.collision", "event.autopilot_lost", "event.fence_breach",
     "event.outcome", "event.mode", "event.attack_start", "event.fault_stop", "event.defence_act", "event.parameter",
     "event.campaign_stage", "event.engine_dead", "decision.avoid"]
)  # fmt: skip
details = st.dictionaries(
    st.sampled_from(["with", "reason", "state", "speed_mps", "energy_j", "action", "frame", "stage", "mode"]),
    texts | st.floats() | st.none() | st.booleans() | st.sampled_from(["radio_failsafe"]),
)
notes = st.builds(lambda *parts: ("note", *parts), times, kinds, texts, details)
acts = st.builds(
    lambda *parts: ("act", *parts),
    times,
    texts,
    st.sampled_from(["send", "drop", "body", "other"]),
    texts,
    st.booleans(),
)
alerts = st.builds(lambda *parts: ("alert", *parts), times, texts, texts, texts)
happenings = st.lists(notes | acts | alerts, max_size=40)


def collect(rows: Iterable[tuple[Any, ...]], collector: EventCollector | None = None) -> EventCollector:
    """An observer that was told all of it."""
    collector = collector or EventCollector()
    for what, now, *more in rows:
        if what == "note":
            kind, about, data = more
            collector.on_note(now, "source", Note(kind, about, data))
        elif what == "act":
            attack, action, link, fault = more
            frame = FrameId(link, "fwd", "sender", 0)
            collector.on_label(Label(now, attack, "actor", action, frame, fault=fault))
        else:
            detector, kind, subject = more
            collector.on_alert(now, detector, Alert(now, subject, kind, 1.0))
    return collector


def draw(lines: Iterable[RenderableType], width: int) -> str:
    console = EscapingConsole(file=io.StringIO(), width=width, force_terminal=True, color_system=None, highlight=False)
    console.print(Group(*lines))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert isinstance(text, str)
    return text


@given(happenings, st.integers(20, 120))
def test_any_text_is_one_line_within_the_terminal_and_controls_nothing(rows: list[Any], width: int) -> None:
    lines = FlightLines(3)
    lines.add(collect(rows).take())
    groups = [(f"{place} {row}", 2, 0.5) for place, row in enumerate(rows)]
    events = [GroupEvents(name, "folder", collect(rows).take()) for name, _, _ in groups]
    grouped = GroupLines().render(groups, events)
    drawn = draw([*lines.render(), *grouped], width)
    shown = min(len(groups), MAX_OBSERVED) * len(lines.render())
    assert len(grouped) == min(len(groups), MAX_GROUPS) + shown + (len(groups) > MAX_GROUPS)
    assert drawn.count("\n") == len(lines.render()) + len(grouped)
    assert max(map(cell_len, drawn.split("\n"))) <= width
    assert [
        one for one in drawn if category(one) in ("Cc", "Cf", "Cs", "Zl", "Zp") and one not in "\n\u200c\u200d"
    ] == []


@given(happenings, st.lists(st.integers(0, 40), max_size=4))
def test_reports_together_have_all_that_one_report_has(rows: list[Any], cuts: list[int]) -> None:
    """Taken in any steps, and through a process boundary: counts of acts, alerts and notes are those of the flight."""
    whole = collect(rows).take()
    collector, parts = EventCollector(), []
    for start, end in zip([0, *sorted(cuts)], [*sorted(cuts), len(rows)], strict=True):
        collect(rows[start:end], collector)
        sent = json.loads(pack_message("status", events=describe_report(collector.take(), max_bytes=10**7)))
        parts.append(EventReport.read(sent["events"]))
    assert [note[:3] for part in parts for note in part.notes] == [note[:3] for note in whole.notes]
    counted: Counter[tuple[str, ...]] = Counter()
    for part in parts:
        counted.update({tally[:4]: tally.number for tally in part.tallies})
    assert counted == {tally[:4]: tally.number for tally in whole.tallies}
    assert sum(counted.values()) == sum(row[0] != "note" or row[2] == "event.defence_act" for row in rows)
    assert all(part.left_out == 0 for part in parts)


@given(st.integers(0, 3 * MAX_ROWS), st.integers(0, 2 * MAX_ROWS), st.sampled_from(["ascii", "\u2028" * 200]))
def test_a_report_fits_in_a_message_and_says_what_it_leaves_out(crashes: int, attacks: int, name: str) -> None:
    rows: list[tuple[Any, ...]] = [("note", n, "event.crash", f"{name}{n}", {"reason": name}) for n in range(crashes)]
    rows += [("act", n, f"{name}{n}", "send", "rid_up:x", False) for n in range(attacks)]
    collector = collect(rows)
    report = EventReport.read(describe_report(collector.take(300)))
    assert len(report.notes) + sum(tally.number for tally in report.tallies) + report.left_out == crashes + attacks
    if name == "ascii":
        states = len(report.states)
        while more := collector.take(300).states:
            states += len(more)
        assert states == crashes  # none is left out
        assert len(pack_message("status", events=describe_report(collect(rows).take(300)))) < MAX_MESSAGE_BYTES


def test_a_report_that_is_none_is_refused() -> None:
    wrongs: tuple[object, ...] = ({}, [1], [{"a": "gone"}, [], [], 0], [{}, [[1, 2]], [], 0], None)
    for wrong in wrongs:
        with pytest.raises(ValueError, match="EventReport"):
            EventReport.read(wrong)


def test_what_is_lost_stays_lost_and_mishaps_beyond_the_lines_are_counted() -> None:
    lines = FlightLines(9)
    for kind in ("event.takeoff", "event.crash", "event.takeoff", "event.landed"):
        lines.add(collect([("note", 0, kind, "blue/b1.autopilot", {})]).take())
    lines.add(collect([("note", n, "event.crash", f"blue/x{n}", {}) for n in range(MAX_EVENTS + 2)]).take())
    drawn = draw(lines.render(), 100)
    assert f"9 aircraft: 0 flying, 0 landed, {MAX_EVENTS + 3} lost, 3 earlier mishaps" in drawn
    assert drawn.count("crash") == MAX_EVENTS
    assert AircraftState.LOST in collect([("note", 0, "event.collision", "a/b", {})]).take().states.values()


def test_acts_alike_are_one_line_with_their_number() -> None:
    lines = FlightLines(1)
    for second in range(60, 180):
        lines.add(collect([("act", second * NS_PER_S, "ghost", "send", "rid_up:ghost", False)]).take())
    assert draw(lines.render()[1:], 80) == "  179.0 s  ghost: 120 broadcasts since 60.0 s\n"


def test_a_compilation_is_said_while_it_lasts() -> None:
    seen: list[str] = []
    compile_uncached: Any = numba.njit

    class Watching(Compilations):
        def on_start(self, event: Any) -> None:
            super().on_start(event)
            seen.append(stage())

    watching = Watching()
    bar = FlightBar("name", watching, Console(file=io.StringIO(), force_terminal=True, width=90))

    def stage() -> str:
        return draw([bar.make_tasks_table(bar.tasks)], 90)

    with event.install_listener("numba:compile", watching):
        compile_uncached(_double)(1.0)
    assert [COMPILING in one for one in (*seen, stage())] == [True, False]
    assert "starting" in stage()
    with watch_compilations() as compilations:
        pass
    compile_uncached(_double)(1)  # nobody watches any more
    assert (compilations.finished, watching.finished) == (0, 1)


def _double(x: float) -> float:
    return x * 2.0


class Screen(io.StringIO):
    """Standard error that says that it is a terminal."""

    def isatty(self) -> bool:
        return True


def fly_on_screen(scenario: Scenario, folder: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[RunRecord, str]:
    """A run, and all that its terminal showed: of 0.1 s steps every tenth is drawn."""
    screen, show = Screen(), FlightBar.show

    def show_and_draw(bar: FlightBar, *said: Any, **more: Any) -> None:
        show(bar, *said, **more)
        bar.refresh()

    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(progress_module, "monotonic", itertools.count(0.0, 0.021).__next__)
    monkeypatch.setattr(FlightBar, "show", show_and_draw)
    monkeypatch.setenv("COLUMNS", "90")
    monkeypatch.setenv("TERM", "xterm")
    aircraft = sum(1 for _ in scenario.fleet)
    with flight_progress(scenario.name, aircraft, quiet=False) as shown:
        record = fly(
            scenario,
            folder,
            additions=Additions(observers=shown.observers),
            on_progress=shown.on_progress,
            report=False,
        )
    return record, screen.getvalue()


def test_every_mishap_of_a_run_appears_and_its_fingerprint_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = load_scenario("head-on", ["duration_s=40"])
    record, shown = fly_on_screen(scenario, tmp_path / "seen", monkeypatch)
    mishaps = distinct_mishaps(read_notes(record, "events"))
    assert len(mishaps) >= 3
    for row in mishaps:
        what = describe_mishap(row).rpartition(", ")[0]
        assert f"{to_seconds(row.time_ns):7.1f} s  {what}" in shown
    assert "2 aircraft: 2 flying, 0 landed, 0 lost" in shown
    assert "2 aircraft: 0 flying, 0 landed, 2 lost" in shown
    alone = shared_run(scenario)
    assert record.manifest["digests"] == alone.manifest["digests"]


def test_the_last_picture_counts_all_acts_of_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record, shown = fly_on_screen(load_scenario("rid-spoofing", ["duration_s=45"]), tmp_path / "run", monkeypatch)
    labels = record.table("labels").num_rows
    assert labels > 10
    assert f"ghost: {labels} broadcasts since 30.0 s" in shown
    assert f"ghost: {labels + 1} " not in shown
    assert "attack ghost begins" in shown


@pytest.mark.parametrize("unseen", ["quiet", "piped"])
def test_nothing_observes_a_run_without_a_terminal(unseen: str, capsys: pytest.CaptureFixture[str]) -> None:
    with flight_progress("name", 1, quiet=unseen == "quiet") as shown:
        assert shown.observers == ()
        if shown.on_progress is not None:
            shown.on_progress(NS_PER_S, 2 * NS_PER_S)
    assert capsys.readouterr().err == ("" if unseen == "quiet" else "name: 1 of 2 s\n")


def test_a_run_that_cannot_be_observed_has_its_bar_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)
    with flight_progress("name", 1, quiet=False, observed=False) as shown:
        assert shown.observers == ()
        assert shown.on_progress is not None
        shown.on_progress(NS_PER_S, NS_PER_S)
    assert "aircraft" not in screen.getvalue()
    assert "writing the record" in screen.getvalue()
