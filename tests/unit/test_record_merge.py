"""The parts of a live run become the record that one kernel would have written."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.contracts.frames import Fate, Frame, end_journey
from skyrange.contracts.links import Act, Channel, TapPlacement
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.verdicts import Label
from skyrange.core.errors import InputError
from skyrange.core.ids import FrameId
from skyrange.core.time import NEVER, NS_PER_S, Time
from skyrange.record import Recorder, RunRecord, load
from skyrange.record.folder import PARTS
from skyrange.record.live_merge.frame_matching import DATAGRAM_WINDOW_NS, TOLERANCE_NS, FrameMatcher, SentFrame
from skyrange.record.live_merge.merge import describe_parts, merge, recover_run
from tests.probes.test_taps import Meddler
from tests.probes.toys import MS, ROUGH
from tests.unit.live_parts import Flown, fly, frames_of
from tests.unit.record_sample import StillWorld, make_frame

pytestmark = pytest.mark.rotating

WIRE = Channel(mode="reliable", latency_ns=20 * MS, loss=0.1)
TWICE = replace(ROUGH, reorder=0.0)
SHUFFLED = replace(ROUGH, duplicate=0.0, reorder=0.3)
"""Never both at once: of two copies sent at one instant nobody can say which overtook the other."""


def meddled(*sides: str) -> dict[str, Any]:
    return {
        "taps": [TapPlacement("gcs:blue/b1", side, Meddler, "mitm") for side in sides],
        "acts": [Act("mitm")],
    }


def merged(flown: Flown, into: Path) -> tuple[RunRecord, RunRecord]:
    merge(flown.parts, into, flown.header)
    return load(into), load(flown.whole)


def rows(run: RunRecord, table: str) -> list[str]:
    return sorted(map(str, run.table(table).to_pylist()))


def same(found: RunRecord, whole: RunRecord) -> None:
    assert frames_of(found) == frames_of(whole)
    for table in ("decisions", "events", "labels"):
        assert rows(found, table) == rows(whole, table), table
    for table in ("truth", "sensors"):
        assert found.table(table).equals(whole.table(table)), table
    for key in ("digests", "counts", "outcomes", "simulated_s", "record", "operators", "links"):
        assert found.manifest[key] == whole.manifest[key], key
    assert found.messages == whole.messages
    for message in whole.messages:
        assert found.telemetry(message).equals(whole.telemetry(message))


@pytest.mark.parametrize(
    "offset_ns",
    [0, 3 * NS_PER_S // 2, pytest.param(-NS_PER_S, marks=pytest.mark.slow)],
    ids=["one clock", "behind", "ahead"],
)
@pytest.mark.parametrize(
    ("gcs", "sides"),
    [
        (None, ()),
        (TWICE, ()),
        (SHUFFLED, ()),
        (WIRE, ()),
        (None, ("gcs", "companion")),
        (TWICE, ("companion",)),
        (SHUFFLED, ("gcs",)),
    ],
    ids=["steady", "duplicates", "reorders", "reliable", "tapped", "duplicates and tap", "reorders and tap"],
)
def test_two_parts_are_the_record_of_one_kernel(
    tmp_path: Path, gcs: Channel | None, sides: Sequence[str], offset_ns: Time
) -> None:
    flown = fly(tmp_path, gcs, lambda: meddled(*sides) if sides else {}, offset_ns)
    found, whole = merged(flown, tmp_path / "merged")
    same(found, whole)
    assert found.status == "complete"
    assert whole.rows("decisions") > 20
    assert whole.rows("truth") > 20
    assert found.outcomes["blue/b1"]["state"] == "complete"
    assert found.manifest["crossings"]["matched"] > 40
    assert found.manifest["crossings"]["outside"] == 0
    assert bool(whole.rows("labels")) == bool(sides)
    for table, key in (("frames", "sent_ns"), ("decisions", "time_ns"), ("labels", "at_ns"), ("truth", "time_ns")):
        times = found.table(table, [key]).column(0).to_pylist()
        assert times == sorted(times)


def test_copies_that_overtook_each_other_are_counted_and_at_most_swapped(tmp_path: Path) -> None:
    found, whole = merged(fly(tmp_path, ROUGH), tmp_path / "merged")
    pairs = list(zip(frames_of(found), frames_of(whole), strict=True))
    assert all(one.id == other.id and one.payload == other.payload for one, other in pairs)
    swapped = [pair for pair in pairs if pair[0] != pair[1]]
    assert 0 < len(swapped) <= 2 * found.manifest["crossings"]["ambiguous"] < 50
    arrivals = [
        sorted(str((f.link, f.arrived_ns, f.fate, f.payload)) for f in frames_of(run)) for run in (found, whole)
    ]
    assert arrivals[0] == arrivals[1]


# ---------------------------------------------------------------- parts written by hand

GCS = {"name": "gcs:blue/b1", "a": "blue.gcs", "b": "blue/b1.companion", "channel": {"mode": "datagram"}}
LOG = {"name": "log:blue/b1", "a": "blue/b1.companion", "b": "blue.gcs", "channel": {"mode": "reliable", "loss": 0.1}}
HEADER = {"name": "hand", "vehicles": [{"id": "blue/b1", "operator": "blue"}], "links": [GCS, LOG]}
GROUND, AIR = "blue.gcs", "blue/b1.companion"


def part(folder: Path, endpoint: str, frames: Sequence[Frame] = (), until_s: float = 60.0, **told: Any) -> Recorder:
    """A part that is still open: the node of one endpoint told its recorder `frames` in this order."""
    node = {"name": folder.name, "endpoints": [endpoint], "offset_ns": 0, "until_ns": int(until_s * 1e9)}
    recorder = Recorder.open(folder, {**HEADER, "node": node | told})
    for frame in frames:
        recorder.on_frame(frame)
    return recorder


def up(serial: int, at_s: float, payload: bytes, link: str = "gcs:blue/b1", sender: str = GROUND, **more: Any) -> Frame:
    """A frame as its sender records it when it left, for the aircraft."""
    at = round(at_s * 1e9)
    return make_frame(link, "fwd", sender, serial, at, payload, fate=Fate.IN_FLIGHT, src=GROUND, dst=AIR, **more)


def came(serial: int, at_s: float, payload: bytes, fate: Fate = Fate.DELIVERED) -> Frame:
    """A frame as its receiver records it: numbered as it came."""
    at = round(at_s * 1e9)
    return make_frame("gcs:blue/b1", "fwd", GROUND, serial, at, payload, arrived_ns=at, fate=fate, src=GROUND, dst=AIR)


def hand(tmp_path: Path, *parts: Recorder, close: bool = True) -> RunRecord:
    for recorder in parts:
        recorder.close() if close else recorder.flush()
    merge([recorder.path for recorder in parts], tmp_path / "merged", HEADER)
    return load(tmp_path / "merged")


def brief(run: RunRecord) -> list[tuple[str, int, str, float | None]]:
    return [
        (frame.sender, frame.serial, frame.fate, None if frame.arrived_ns is None else frame.arrived_ns / 1e9)
        for frame in run.frames_with_payloads()
    ]


def test_lost_doubled_swapped_and_foreign_datagrams(tmp_path: Path) -> None:
    ground = part(tmp_path / "ground", GROUND, [up(n, n, f"{n}".encode()) for n in range(5)])
    seen = [(0.1, b"0"), (0.2, b"0"), (2.3, b"2"), (3.5, b"evil"), (4.2, b"4"), (4.3, b"3")]
    air = part(tmp_path / "air", AIR, [came(n, at, payload) for n, (at, payload) in enumerate(seen)])
    air.on_note(5 * NS_PER_S, "x", Note("decision.x", "blue/b1", {}, tuple(came(n, 0, b"").id for n in range(7))))
    run = hand(tmp_path, ground, air)
    assert brief(run) == [
        (GROUND, 0, "delivered", 0.1),
        ("outside", 0, "delivered", 0.2),
        (GROUND, 1, "lost", None),
        (GROUND, 2, "delivered", 2.3),
        (GROUND, 3, "delivered", 4.3),
        ("outside", 1, "delivered", 3.5),
        (GROUND, 4, "delivered", 4.2),
    ]
    causes = run.table("decisions").column("causes").to_pylist()[0]
    senders = [(FrameId.parse(cause).sender, FrameId.parse(cause).serial) for cause in causes]
    assert senders == [
        (GROUND, 0), ("outside", 0), (GROUND, 2), ("outside", 1), (GROUND, 4), (GROUND, 3), ("unrecorded", 6),
    ]  # fmt: skip
    assert run.manifest["crossings"] == {
        "matched": 4, "ambiguous": 0, "outside": 2, "unrecorded": 0, "lost": 1, "in_flight": 0,
    }  # fmt: skip


def test_what_left_when_nobody_recorded_stays_in_flight(tmp_path: Path) -> None:
    frames = [up(0, 1.0, b"a"), up(1, 20.0, b"b"), up(2, 59.999, b"c")]
    ground = part(tmp_path / "ground", GROUND, frames)
    air = part(tmp_path / "air", AIR, [], until_s=10.0)
    assert brief(hand(tmp_path, ground, air)) == [
        (GROUND, 0, "lost", None), (GROUND, 1, "in_flight", None), (GROUND, 2, "in_flight", None),
    ]  # fmt: skip


def test_a_tap_that_replaces_where_it_came_and_one_that_injects_where_it_left(tmp_path: Path) -> None:
    forged = up(0, 0.5, b"forged", sender="evil@gcs:blue/b1.gcs", parent=FrameId("gcs:blue/b1", "fwd", GROUND, 0))
    ground = part(tmp_path / "ground", GROUND, [up(0, 0.0, b"lost"), forged, up(1, 1.0, b"old")])
    ground.on_label(
        Label(NS_PER_S // 2, "evil", "evil@gcs:blue/b1.gcs", "inject", forged.id, None, None, True, False, True)
    )
    was = came(1, 1.1, b"old", Fate.REPLACED)
    tap = "swap@gcs:blue/b1.companion"
    child = make_frame("gcs:blue/b1", "fwd", tap, 0, was.sent_ns, b"new", src=GROUND, dst=AIR, parent=was.id)
    air = part(tmp_path / "air", AIR, [came(0, 0.6, b"forged"), was, child])
    air.on_label(Label(was.sent_ns, "swap", tap, "replace", was.id, child.id))
    run = hand(tmp_path, ground, air)
    assert brief(run)[:3] == [
        (GROUND, 0, "lost", None), ("evil@gcs:blue/b1.gcs", 0, "delivered", 0.6), (GROUND, 1, "replaced", None),
    ]  # fmt: skip
    assert [frame.parent for frame in run.frames_with_payloads()][-1] == f"gcs:blue/b1|fwd|{GROUND}|1"
    labels = run.table("labels").to_pylist()
    assert [(row["frame"], row["child"]) for row in labels] == [
        (str(forged.id), None), (f"gcs:blue/b1|fwd|{GROUND}|1", str(child.id)),
    ]  # fmt: skip
    assert [(row["benign"], row["harmless_intrusion"]) for row in labels] == [(True, True), (False, False)]


def test_a_killed_part_gives_what_it_had(tmp_path: Path) -> None:
    ground = part(tmp_path / "ground", GROUND, [up(n, n / 10, f"{n}".encode()) for n in range(100)])
    air = part(tmp_path / "air", AIR, until_s=0, until_ns=None)
    world: Any = StillWorld(["blue/b1"])
    for n in range(100):
        air.on_frame(came(n, n / 10 + 0.05, f"{n}".encode()))
        air.on_truth(n * 100 * MS, world)
        if n % 10 == 9:
            air.flush()
    ground.close()
    stream = tmp_path / "air" / ".spool" / "frames-0000.arrows"
    stream.write_bytes(stream.read_bytes()[:-20])
    truth = tmp_path / "air" / ".spool" / "truth-0000.arrows"
    truth.write_bytes(truth.read_bytes()[:-400])
    absent = tmp_path / "absent"
    merge([ground.path, air.path, absent], tmp_path / "merged", HEADER, status="failed", extra={"reason": "killed"})
    run = load(tmp_path / "merged")
    fates = [fate for _, _, fate, _ in brief(run)]
    assert fates[:90] == ["delivered"] * 90
    assert len(fates) == 100
    assert set(fates[90:]) <= {"lost", "in_flight"}
    assert run.rows("truth") == 90
    assert (run.status, run.manifest["reason"]) == ("failed", "killed")
    nodes = {node["name"]: node for node in run.manifest["nodes"]}
    assert {name: node["status"] for name, node in nodes.items()} == {
        "ground": "complete", "air": "killed", "absent": "missing",
    }  # fmt: skip
    assert nodes["air"]["rows"]["frames"] == 90
    assert nodes["air"]["rows"]["truth"] == 90
    assert "absent" in nodes["absent"]["problems"][0]


def test_frames_of_a_killed_sender_are_not_from_outside(tmp_path: Path) -> None:
    ground = part(tmp_path / "ground", GROUND, [up(0, 1.0, b"a")], until_s=0, until_ns=None)
    air = part(tmp_path / "air", AIR, [came(0, 1.1, b"a"), came(1, 1.2, b"b")])
    assert [row[:2] for row in brief(hand(tmp_path, ground, air, close=False))] == [(GROUND, 0), ("unrecorded", 0)]


def test_a_node_that_began_anew_counts_on(tmp_path: Path) -> None:
    first = part(tmp_path / "first", GROUND, [up(0, 1.0, b"a"), up(1, 2.0, b"b")], until_s=3)
    second = part(tmp_path / "second", GROUND, [up(0, 10.0, b"c")])
    second.on_note(11 * NS_PER_S, "gcs", Note("event.x", "blue/b1", {}, (up(0, 10.0, b"c").id,)))
    air = part(tmp_path / "air", AIR, [came(n, at, p) for n, (at, p) in enumerate([(1.1, b"a"), (10.1, b"c")])])
    run = hand(tmp_path, second, first, air)
    assert brief(run) == [(GROUND, 0, "delivered", 1.1), (GROUND, 1, "lost", None), (GROUND, 2, "delivered", 10.1)]
    assert run.table("events").column("causes").to_pylist() == [[f"gcs:blue/b1|fwd|{GROUND}|2"]]


def test_a_node_that_was_away_lost_nothing_it_could_have_had(tmp_path: Path) -> None:
    first = part(tmp_path / "first", GROUND, [up(0, 1.0, b"a")], until_s=3)
    second = part(tmp_path / "second", GROUND, [up(0, 10.0, b"b")])
    down = [
        make_frame("gcs:blue/b1", "rev", AIR, n, at * NS_PER_S, b"%d" % n, fate=Fate.IN_FLIGHT)
        for n, at in enumerate((2, 5, 12))
    ]
    run = hand(tmp_path, first, second, part(tmp_path / "air", AIR, down))
    fates = {row[:2]: row[2] for row in brief(run)}
    assert [fates[AIR, n] for n in range(3)] == ["lost", "in_flight", "lost"]


def test_a_complete_part_lasted_until_the_end_though_nothing_came(tmp_path: Path) -> None:
    ground = part(tmp_path / "ground", GROUND, [up(0, 1.0, b"a"), up(1, 50.0, b"b")], until_ns=None)
    air = part(tmp_path / "air", AIR, until_ns=None)
    assert brief(hand(tmp_path, ground, air)) == [(GROUND, 0, "lost", None), (GROUND, 1, "in_flight", None)]


def test_clocks_may_differ_by_milliseconds(tmp_path: Path) -> None:
    ground = part(tmp_path / "ground", GROUND, [up(0, 1.003, b"a"), up(1, 2.006, b"b")])
    air = part(tmp_path / "air", AIR, [came(0, 1.0, b"a"), came(1, 2.0, b"b")])
    assert brief(hand(tmp_path, ground, air)) == [
        (GROUND, 0, "delivered", 1.0), ("outside", 0, "delivered", 2.0), (GROUND, 1, "lost", None),
    ]  # fmt: skip


def test_frames_that_taps_held(tmp_path: Path) -> None:
    """One where it left, for half a minute; one of two with the same bytes where it came, so it was recorded later."""
    sent = [up(1, 1.0, b"x"), up(2, 1.0, b"x"), up(3, 30.0, b"y"), up(0, 0.0, b"held")]
    late = came(0, 1.1, b"x")
    end_journey(late, late.fate, 2 * NS_PER_S)
    air = part(tmp_path / "air", AIR, [came(1, 1.1, b"x"), late, came(2, 30.1, b"y"), came(3, 30.2, b"held")])
    assert brief(hand(tmp_path, part(tmp_path / "ground", GROUND, sent), air)) == [
        (GROUND, 0, "delivered", 30.2), (GROUND, 1, "delivered", 2.0), (GROUND, 2, "delivered", 1.1),
        (GROUND, 3, "delivered", 30.1),
    ]  # fmt: skip


def test_times_move_with_the_clock_but_never_stays_never(tmp_path: Path) -> None:
    air = part(tmp_path / "air", AIR, offset_ns=NS_PER_S)
    id_ = FrameId("l", "fwd", "s", 0)
    air.on_label(Label(MS, "a", "a.tap", "delay", id_, None, NEVER))
    air.on_label(Label(2 * MS, "a", "a.tap", "delay", id_, None, 3 * MS))
    air.on_truth(4 * MS, StillWorld(["blue/b1"]))
    run = hand(tmp_path, air)
    times = run.table("labels", ["at_ns", "until_ns"]).to_pylist()
    assert [tuple(row.values()) for row in times] == [(NS_PER_S + MS, NEVER), (NS_PER_S + 2 * MS, NS_PER_S + 3 * MS)]
    assert run.manifest["simulated_s"] == 1.004
    assert run.table("truth", ["time_ns"]).column(0).to_pylist() == [NS_PER_S + 4 * MS]


def test_a_header_that_cannot_be_written_leaves_the_parts(tmp_path: Path) -> None:
    run = tmp_path / "run"
    air = part(run / ".parts" / "air", AIR, [came(0, 1.0, b"x")])
    air.close()
    with pytest.raises(InputError, match="JSON"):
        merge([air.path], run, HEADER | {"odd": object()})
    assert [path.name for path in run.iterdir()] == [".parts"]
    assert load(air.path).rows("frames") == 1


def test_receptions_name_who_truly_sent(tmp_path: Path) -> None:
    ground = part(tmp_path / "ground", GROUND, [up(0, 0.0, b"lost"), up(1, 1.0, b"heard")])
    air = part(tmp_path / "air", AIR, [came(0, 1.1, b"heard")])
    floats = {name: pa.array([0.0], pa.float32()) for name in ("east_m", "north_m", "up_m", "rssi_dbm", "snir_db")}
    names = {"link": "gcs:blue/b1", "direction": "fwd", "sender": GROUND, "receiver": "r", "transport": "bt4"}
    row = {"time_ns": [NS_PER_S], "serial": [0], "channel": [37], "outcome": ["decoded"]} | floats
    row |= {name: [value] for name, value in names.items()}
    columns = load(air.path).tables.schema("receptions")
    air.on_rows("receptions", pa.RecordBatch.from_pydict(row, schema=columns))
    (found,) = hand(tmp_path, ground, air).table("receptions").to_pylist()
    assert (found["sender"], found["serial"]) == (GROUND, 1)


def test_reliable_lanes_pass_over_what_was_lost_with_a_connection(tmp_path: Path) -> None:
    sent = [up(0, 0.0, b"same", "log:blue/b1", AIR), up(1, 1.0, b"b", "log:blue/b1", AIR)]
    sent += [up(2, 2.0, b"same", "log:blue/b1", AIR), up(3, 3.0, b"still retransmitted", "log:blue/b1", AIR)]
    air = part(tmp_path / "air", AIR, sent)
    seen = [(1.1, b"b"), (2.1, b"same")]
    ground = part(tmp_path / "ground", GROUND)
    for n, (at, payload) in enumerate(seen):
        ground.on_frame(make_frame("log:blue/b1", "fwd", AIR, n, int(at * 1e9), payload, arrived_ns=int(at * 1e9)))
    assert brief(hand(tmp_path, ground, air)) == [
        (AIR, 0, "lost", None), (AIR, 1, "delivered", 1.1), (AIR, 2, "delivered", 2.1), (AIR, 3, "in_flight", None),
    ]  # fmt: skip


def test_files_of_the_parts_and_the_folder_of_the_run(tmp_path: Path) -> None:
    run = tmp_path / "run"
    air = part(run / ".parts" / "air", AIR, [came(0, 1.0, b"x")])
    air.keep_file("logs/autopilot.log", Path(__file__))
    air.close()
    merge([air.path], run, HEADER)
    assert (run / "logs" / "autopilot.log").read_bytes() == Path(__file__).read_bytes()
    assert load(run).status == "complete"
    assert load(air.path).rows("frames") == 1
    assert not (run / ".spool").exists()
    with pytest.raises(InputError, match="holds"):
        merge([air.path], run, HEADER)
    assert load(air.path).rows("frames") == 1


def test_a_damaged_table_is_named_and_the_others_are_merged(tmp_path: Path) -> None:
    air = part(tmp_path / "air", AIR, [came(0, 1.0, b"x")])
    air.on_truth(4 * MS, StillWorld(["blue/b1"]))
    air.close()
    (tmp_path / "air" / "frames.parquet").write_bytes(b"PAR1")
    merge([air.path], tmp_path / "merged", HEADER)
    run = load(tmp_path / "merged")
    assert (run.rows("frames"), run.rows("truth")) == (0, 1)
    assert "frames.parquet" in run.manifest["nodes"][0]["problems"][0]


@pytest.mark.parametrize("node", [None, {"name": "x"}, {"name": "x", "endpoints": [1], "offset_ns": 0}])
def test_a_part_that_does_not_say_whose_it_is_is_named(tmp_path: Path, node: object) -> None:
    air = part(tmp_path / "air", AIR, [came(0, 1.0, b"x")])
    air.close()
    path = tmp_path / "air" / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"node": node}))
    merge([air.path], tmp_path / "merged", HEADER)
    (entry,) = load(tmp_path / "merged").manifest["nodes"]
    assert entry["status"] == "missing"
    assert "endpoints" in entry["problems"][0]


# ---------------------------------------------------------------- the matching alone

DELAYS = st.one_of(st.none(), st.integers(0, 40))


@settings(max_examples=200)
@given(st.lists(st.tuples(st.integers(0, 30), st.lists(DELAYS, min_size=1, max_size=2)), max_size=40))
def test_matching_finds_every_frame_of_its_own_bytes(pattern: list[tuple[int, list[int | None]]]) -> None:
    """Gaps between sent frames, and what delays (ms) their copies have: lost, reordered, doubled in any way."""
    lane: FrameMatcher[int] = FrameMatcher(reliable=False)
    events, at = [], 0
    expected = {}
    for number, (gap, delays) in enumerate(pattern):
        at += gap * MS
        events.append((at, 0, number))
        arrivals = sorted(at + delay * MS for delay in delays if delay is not None)
        events += [(arrival + TOLERANCE_NS, 1, number) for arrival in arrivals]
        if arrivals:
            expected[number] = arrivals[0]
    found: dict[int, Time] = {}
    strangers = 0
    for time, came_in, number in sorted(events):
        if not came_in:
            lane.add_sent(SentFrame(number, time, time, b"%d" % number, number))
            continue
        match = lane.match_received(time - TOLERANCE_NS, b"%d" % number)
        strangers += match is None
        if match is not None:
            assert match.row == number
            found[number] = time - TOLERANCE_NS
    assert found == expected
    assert strangers == sum(came_in for _, came_in, _ in events) - len(expected)
    assert sorted(frame.row for frame, _ in lane.remaining()) == sorted(set(range(len(pattern))) - set(expected))
    assert lane.ambiguous == 0


@settings(max_examples=200)
@given(st.lists(st.tuples(st.integers(0, 2), st.booleans()), max_size=60))
def test_matching_on_a_reliable_lane_keeps_order_whatever_recurs(frames: list[tuple[int, bool]]) -> None:
    """Of few distinct payloads some are lost: matches are in order, of equal bytes, and as many as came in."""
    lane: FrameMatcher[int] = FrameMatcher(reliable=True)
    matched: list[int] = []
    for number, (kind, lost) in enumerate(frames):
        lane.add_sent(SentFrame(number, number * MS, number * MS, b"%d" % kind, number))
        if not lost:
            match = lane.match_received((number + 1) * MS, b"%d" % kind)
            assert match is not None
            assert frames[match.row][0] == kind
            matched.append(match.row)
    assert len(set(matched)) == len(matched) == sum(not lost for _, lost in frames)
    if not any(lost for _, lost in frames):
        assert matched == list(range(len(frames)))


def test_matching_forgets_what_cannot_come_any_more() -> None:
    lane: FrameMatcher[int] = FrameMatcher(reliable=False)
    for number in range(1000):
        lane.add_sent(SentFrame(number, number * MS, number * MS, b"x", number))
    assert lane.match_received(TOLERANCE_NS, b"y") is None
    assert len(lane.expired(DATAGRAM_WINDOW_NS + 500 * MS)) == 500
    assert lane.expired(DATAGRAM_WINDOW_NS + 500 * MS) == []
    match = lane.match_received(DATAGRAM_WINDOW_NS + 500 * MS, b"x")
    assert match is not None
    assert match.row == 500
    held = SentFrame(
        2000, 0, 2 * DATAGRAM_WINDOW_NS, b"held", 2000
    )  # by a tap, for longer than a datagram is waited for
    lane.add_sent(held)
    assert lane.match_received(2 * DATAGRAM_WINDOW_NS + 1, b"held") is held


def test_matching_takes_nothing_from_the_future() -> None:
    lane: FrameMatcher[int] = FrameMatcher(reliable=False)
    lane.add_sent(SentFrame(0, NS_PER_S, NS_PER_S, b"x", 0))
    assert lane.match_received(NS_PER_S - TOLERANCE_NS - 1, b"x") is None
    assert lane.match_received(NS_PER_S - TOLERANCE_NS, b"x") is not None


def test_a_killed_range_is_recovered_with_the_settings_of_its_record(tmp_path: Path) -> None:
    flown = fly(tmp_path, None)
    run = tmp_path / "run"
    Recorder.open(run, flown.header, truth_hz=5.0, sensors_hz=1.0, csv=True).flush()
    for part in flown.parts:
        shutil.copytree(part, run / PARTS / part.name)
    with pytest.raises(InputError, match="still written to"):
        recover_run(run, tmp_path / "early")
    assert "flying, or its records are being merged" in describe_parts(run, "running")
    for path in (run / PARTS).rglob("*"):
        os.utime(path, (0, 0))
    with pytest.raises(InputError, match="still written to"):  # the supervisor merges what the parts have
        recover_run(run, tmp_path / "early")
    assert "being merged" in describe_parts(run, "running")
    for path in run.rglob("*"):
        os.utime(path, (0, 0))
    assert f"`skyrange merge {run}`" in describe_parts(run, "running")
    recover_run(run, tmp_path / "out")
    assert describe_parts(tmp_path / "out", "failed") == ""
    found = load(tmp_path / "out")
    assert found.manifest["status"] == "failed"
    assert found.manifest["record"] == {
        "level": "full", "truth_hz": 5.0, "sensors_hz": 1.0, "features_hz": 1.0, "csv": True
    }  # fmt: skip
    assert frames_of(found) == frames_of(load(flown.whole))
    assert list((found.path / "operators").glob("*.tlog"))
