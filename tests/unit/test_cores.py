"""The parts of a run on several cores: exchange among processes, division of operators, barriers, gaps."""

from __future__ import annotations

import os
import signal
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.assembly.build import build
from skyrange.bench import cores as bench_cores
from skyrange.bench.fleet import FleetOptions, fleet_scenario
from skyrange.contracts.frames import DirectedLinkName, Fate, Frame, FrameBlock, LinkTable, Payloads
from skyrange.contracts.links import Channel, LinkSpec, ProcessingLimit
from skyrange.contracts.mailboxes import Arrival, Inbox
from skyrange.core.errors import ComponentError
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NS_PER_MS, NS_PER_S, ceil_to
from skyrange.kernel import Transit, Wiring
from skyrange.radio.oracle import STEP_NS
from skyrange.runtime.cores import division
from skyrange.runtime.cores.division import Barriers, Crossing, Division, divide, find_barriers
from skyrange.runtime.cores.exchange import MAX_AHEAD, CoreFailedError, Exchange, Member, Topic
from skyrange.runtime.cores.frame_messages import (
    list_transmissions,
    pack_inbox,
    pack_transits,
    unpack_inbox,
    unpack_transits,
)
from skyrange.runtime.cores.oracle_replica import AHEAD_NS, arrive_ahead
from skyrange.runtime.cores.separation import ACCELERATION_MPS2, TUMBLING_MPS, FleetMotion, Separation
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.toml_files import load_text
from skyrange.world.airframes import AIRFRAMES, GRAVITY_MPS2, MOTORS

pytestmark = pytest.mark.rotating

QUANTUM_NS = 2_500_000
PERIOD_NS = 25 * NS_PER_MS


# ------------------------------------------------------------------ exchange


def _in_processes(count: int, work: Callable[[Member], None], area_bytes: int = 64) -> list[int]:
    """Run `work` in forked processes; returns their exit codes."""
    exchange = Exchange(count, area_bytes)
    pids = []
    for number in range(count):
        pid = os.fork()
        if pid == 0:
            code = 1
            try:
                signal.alarm(30)
                work(exchange.join(number))
                code = 0
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(code)
        pids.append(pid)
    exchange.join(-1)
    return [os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) for pid in pids]


def _go_on(member: Member) -> None:
    for round_ in range(1, 9):
        member.gather(Topic.RADIO, round_, b"x")


def _part(member: int, round_: int) -> bytes:
    size = (37 * member + 101 * round_) % 300
    return bytes((member * 17 + round_ + place) % 256 for place in range(size))


@pytest.mark.parametrize("count", [2, 3, 5])
def test_all_get_the_parts_of_all(count: int) -> None:
    def work(member: Member) -> None:
        for round_ in range(60):
            parts = member.gather(Topic.RADIO, round_, _part(member.number, round_))
            assert parts == [_part(other, round_) for other in range(count)]

    assert _in_processes(count, work) == [0] * count


@pytest.mark.parametrize("count", [2, 3, 4])
def test_rounds_may_be_posted_ahead(count: int) -> None:
    """One process after the other stops between what it posts and what it collects, while all others run ahead."""

    def work(member: Member) -> None:
        for round_ in range(60):
            member.post(Topic.BARRIER, round_, _part(member.number, round_))
            if round_ % 20 == 10 + member.number:
                time.sleep(0.02)
            if round_ < MAX_AHEAD:
                continue
            then = round_ - MAX_AHEAD
            assert member.collect(Topic.BARRIER, then) == [_part(other, then) for other in range(count)]

    assert _in_processes(count, work, area_bytes=512) == [0] * count


def test_topics_have_rounds_of_their_own() -> None:
    def work(member: Member) -> None:
        for round_ in range(30):
            member.post(Topic.BARRIER, round_, _part(member.number, round_))
            assert member.gather(Topic.RADIO, round_, b"%d" % member.number) == [b"0", b"1"]
            assert member.collect(Topic.BARRIER, round_) == [_part(other, round_) for other in range(2)]

    assert _in_processes(2, work) == [0, 0]


def test_a_process_cannot_post_more_than_the_areas_hold() -> None:
    def work(member: Member) -> None:
        for round_ in range(1 + MAX_AHEAD):
            member.post(Topic.BARRIER, round_, b"x")
        with pytest.raises(ValueError, match="topic BARRIER were posted and not collected"):
            member.post(Topic.BARRIER, 9, b"x")
        member.gather(Topic.END, 0, b"")

    assert _in_processes(2, work) == [0, 0]


def test_what_was_posted_before_a_failure_is_still_collected() -> None:
    def work(member: Member) -> None:
        member.post(Topic.BARRIER, 0, b"whole")
        if member.number == 1:
            member.fail("the reason")
            member.close()
            return
        time.sleep(0.05)
        assert member.collect(Topic.BARRIER, 0) == [b"whole"] * 3
        with pytest.raises(CoreFailedError, match="core 1: the reason"):
            member.gather(Topic.BARRIER, 1, b"")

    assert _in_processes(3, work) == [0, 0, 0]


def test_a_failure_reaches_all_others_with_its_reason() -> None:
    def work(member: Member) -> None:
        member.gather(Topic.RADIO, 0, b"")
        if member.number == 1:
            member.fail("the reason")
            return
        with pytest.raises(CoreFailedError, match="core 1: the reason"):
            member.gather(Topic.RADIO, 1, b"")

    assert _in_processes(4, work) == [0] * 4


def test_a_killed_process_is_noticed_by_all_others() -> None:
    def work(member: Member) -> None:
        member.gather(Topic.RADIO, 0, b"")
        if member.number == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        with pytest.raises(CoreFailedError, match=r"core .: its process ended unexpectedly"):
            _go_on(member)

    assert _in_processes(3, work) == [0, 0, -signal.SIGKILL]


def test_processes_out_of_step_are_told_apart() -> None:
    def work(member: Member) -> None:
        with pytest.raises(ComponentError, match="out of step"):
            member.gather(Topic.RADIO, member.number, b"")

    assert _in_processes(2, work) == [0, 0]


def test_frames_under_way_survive_packing() -> None:
    parent, cause = FrameId("a", "fwd", "x", 1), FrameId("b", "rev", "y", 2)
    sent = [
        Transit(
            9,
            "a:fwd",
            Frame(
                "a",
                "fwd",
                "é|x",
                3,
                "é|x",
                "z",
                sent_ns=5,
                payload=bytes(range(256)),
                parent=parent,
                causes=(cause, parent),
            ),
        ),
        Transit(7, "b:rev", Frame("b", "rev", "y", 0, "y", "x", sent_ns=6, payload=b"")),
    ]
    got = list(unpack_transits(pack_transits(sent)))
    assert [(one.arrival, one.directed_link) for one in got] == [(9, "a:fwd"), (7, "b:rev")]
    for mine, theirs in zip(got, sent, strict=True):
        assert all(getattr(mine.frame, name) == getattr(theirs.frame, name) for name in Frame.__slots__)
    assert list(unpack_transits(pack_transits([]))) == []


def test_transmissions_of_other_cores_are_listed_as_they_were_sent() -> None:
    links = LinkTable([DirectedLinkName(f"rid_up:{v}", "fwd", f"{v}.companion", "oracle") for v in "abc"], np.arange(3))
    bodies = [b"one", b"", b"three", b"\0\xff"]
    blocks = [
        FrameBlock(links, np.array([2, 0]), np.array([7, 9]), 50, 60, Fate.DELIVERED, payloads=Payloads.of(bodies[:2])),
        FrameBlock(
            links,
            np.array([2]),
            np.array([8]),
            70,
            80,
            Fate.DELIVERED,
            payloads=Payloads.of(bodies),
            rows=np.array([3]),
        ),
    ]
    single = Arrival(Port("oracle", "rid_up:x"), 65, b"single", "x.companion", FrameId("rid_up:x", "fwd", "x", 4))
    first = unpack_inbox(pack_inbox(Inbox([single], blocks[:1])), links)
    table = list_transmissions([first, Inbox([], blocks[1:])])
    assert table is not None
    found = sorted(tuple(row.values()) for row in table.to_pylist())
    assert found == [
        ("rid_up:a", "fwd", "a.companion", 9, 50, 60, b""),
        ("rid_up:c", "fwd", "c.companion", 7, 50, 60, b"one"),
        ("rid_up:c", "fwd", "c.companion", 8, 70, 80, b"\0\xff"),
        ("rid_up:x", "fwd", "x", 4, 65, 65, b"single"),
    ]
    assert list_transmissions([Inbox([], [])]) is None


def _wire(channel: Channel, served_ns: int, tapped: bool) -> Wiring:
    agent = Mock(ports=[Port("a.companion", "rid_up:a")], service_ns=served_ns)
    tap = Mock(find_ends=lambda spec: ["a.companion"] if tapped else [])
    return Wiring(0, [LinkSpec("rid_up:a", "a.companion", "oracle", channel)], agents=[agent], taps=[tap])


at_any_time = st.integers(0, 40).map(lambda halves: 500_000 * halves)


@given(st.sampled_from([1_000, 20_000_000, 30_000_000, 50_000_000, 5_000_000]), at_any_time, st.integers(0, 500))
def test_what_arrives_ahead_is_there_before_the_exchange_begins(served_ns: int, latency_ns: int, nth: int) -> None:
    channel = Channel(latency_ns=max(latency_ns, 1_000))
    if arrive_ahead(_wire(channel, served_ns, False), ["a.companion"]):
        late_ns = (served_ns * nth + channel.latency_ns) % STEP_NS
        assert 0 < late_ns <= STEP_NS - AHEAD_NS


def test_broadcasts_of_a_scenario_arrive_ahead() -> None:
    wiring = build(fleet_scenario(2, 1.0, FleetOptions(remote_id=True, operators=2))).wiring
    everywhere = {end for spec in wiring.links for end in (spec.a, spec.b)}
    assert "oracle" in everywhere
    assert arrive_ahead(wiring, everywhere - {"oracle"})


def test_only_what_is_certain_arrives_ahead() -> None:
    steady, here = Channel(latency_ns=100_000), ["a.companion"]
    assert arrive_ahead(_wire(steady, 50 * NS_PER_MS, False), here)
    assert not arrive_ahead(_wire(steady, 50 * NS_PER_MS, True), here)
    assert arrive_ahead(_wire(steady, 1_000, True), [])  # those of other cores are for these to tell
    assert not arrive_ahead(_wire(steady, 1_000, False), here)
    assert not arrive_ahead(_wire(replace(steady, jitter_ns=1), 50 * NS_PER_MS, False), here)
    assert not arrive_ahead(_wire(replace(steady, rate_bps=1e6), 50 * NS_PER_MS, False), here)
    limited = replace(_wire(steady, 50 * NS_PER_MS, False), processing=[ProcessingLimit("oracle", 10.0, 5)])
    assert not arrive_ahead(limited, here)


# ------------------------------------------------------------------ barriers

crossings = st.lists(
    st.builds(
        Crossing,
        st.sampled_from([1_000, 100_000, 2_500_000, 3_000_000, 20_000_000, 25_000_000, 400_000_000]),
        st.sampled_from([0, 2_500_000, 10_000_000, 15_000_000, 20_000_000, 100_000_000]),
    ).filter(lambda one: one.service_ns > 0 or one.latency_ns >= QUANTUM_NS),
    max_size=4,
)


@given(crossings, st.lists(st.integers(0, NS_PER_S), min_size=1, max_size=20))
def test_no_frame_arrives_before_the_barrier_at_which_it_is_passed_on(links: list[Crossing], times: list[int]) -> None:
    period, lag = find_barriers(links, QUANTUM_NS, 100 * NS_PER_MS)
    assert period > 0
    assert period % QUANTUM_NS == 0
    for link in links:
        for wish in times:
            sent = ceil_to(wish, link.service_ns) if link.service_ns else wish
            assert sent + link.latency_ns > ceil_to(sent, period) + lag * period


def test_barriers_are_as_far_apart_as_links_allow() -> None:
    remote_id = Crossing(100_000, 20 * NS_PER_MS)  # a tenth of a millisecond, sent every 20 ms
    approval = Crossing(25 * NS_PER_MS, 20 * NS_PER_MS)
    slow = Crossing(70 * NS_PER_MS, 0)
    at_most = 100 * NS_PER_MS
    assert find_barriers([], QUANTUM_NS, at_most) == Barriers(at_most, 1)
    assert find_barriers([approval], QUANTUM_NS, at_most) == Barriers(20 * NS_PER_MS, 1)
    assert find_barriers([slow], QUANTUM_NS, at_most) == Barriers(35 * NS_PER_MS, 1)
    assert find_barriers([approval, remote_id], QUANTUM_NS, at_most) == Barriers(20 * NS_PER_MS, 0)
    assert find_barriers([Crossing(100_000, 0)], QUANTUM_NS, at_most) == Barriers(QUANTUM_NS, 0)


# ------------------------------------------------------------------ division


@pytest.fixture(scope="module", autouse=True)
def _eight_cpus() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(division, "available_cpus", lambda: list(range(8)))
        yield


def test_no_more_cores_are_used_than_there_are_cpus(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(division, "available_cpus", lambda: [3, 5])
    found = divide(_scenario([60, 60, 60]), 3)
    assert (found.cores, found.reason) == (2, "this process may use 2 CPUs")


def _scenario(sizes: list[int], more: str = "") -> Scenario:
    text = 'name = "d"\nduration_s = 1\nstart_utc = 2026-01-01T12:00:00Z\norigin = { lat = 0, lon = 0 }\n' + more
    for number, size in enumerate(sizes):
        text += f'[[operators]]\nid = "o{number}"\n  [[operators.fleets]]\n  count = {size}\n'
        text += f"  start = [{1000 * number}, 0]\n  spacing_m = [20, 20]\n"
        text += "  plan = { path = { points = [[0, 0], [0, 30]], alt_m = 20 } }\n"
    return load_text(text)


@given(st.lists(st.integers(1, 120), min_size=2, max_size=7), st.integers(2, 6))
@settings(max_examples=20, deadline=None)
def test_every_operator_is_on_one_core(sizes: list[int], cores: int) -> None:
    scenario = _scenario(sizes)
    division = divide(scenario, cores)
    assert sorted(operator for part in division.operators for operator in part) == [f"o{n}" for n in range(len(sizes))]
    assert 1 <= division.cores <= cores
    assert all(division.operators)
    assert bool(division.reason) == (division.cores < cores)
    loads = [len(division.vehicles(scenario, core)) for core in range(division.cores)]
    assert max(loads) - min(loads) <= max(sizes)
    ends = [division.endpoints(scenario, core) for core in range(division.cores)]
    for name in ("o0.gcs", "o1/1.autopilot", "approval", "somebody.else"):
        assert sum(name in one for one in ends) == 1
    assert all("oracle" in one for one in ends)


ACT = '[[attacks]]\nid = "%s"\nkind = "%s"\nparams = { %s }\n'


@pytest.mark.parametrize(
    ("sizes", "more", "reason"),
    [
        ([200], "", "all aircraft belong to one operator, whose ground station is one program"),
        ([9, 9], "", "a core pays for 50 aircraft or more, and there are 18"),
        ([90, 90], "[radio]\n", "a core pays for 200 aircraft that broadcast or more, and there are 180"),
        ([60, 60], "", "operators are divided among the cores, and there are 2"),
        (
            [60, 60],
            ACT % ("x", "gnss.jump", 'vehicles = ["o0/o1", "o1/o1"], offset_m = [9, 0, 0]'),
            "'x' may have to do with all operators in common",
        ),
        (
            [60, 60],
            '[[links]]\nmatch = "gcs:*"\nchannel = "wifi"\n[radio]\n',
            "control links over the air share one spectrum",
        ),
    ],
)
def test_what_is_not_divided_says_why(sizes: list[int], more: str, reason: str) -> None:
    assert divide(_scenario(sizes, more), 4).reason.startswith(reason)


def test_attacks_keep_operators_on_the_first_core_or_leave_them_free() -> None:
    on_links = ACT % ("drop", "link.drop", 'links = ["gcs:*"]')
    on_sensors = ACT % ("jump", "gnss.jump", 'vehicles = ["o2/o1", "o1/o2"], offset_m = [9, 0, 0]')
    division = divide(_scenario([40, 50, 30, 30], on_links + on_sensors), 2)
    assert division.operators == (("o1", "o2"), ("o0", "o3"))
    assert division.binding.operators == {"o1": "jump", "o2": "jump"}
    assert division.binding.divisible == {"drop"}
    three = divide(_scenario([60, 50, 50], on_sensors), 3)
    assert three.operators == (("o1", "o2"), ("o0",))
    assert three.reason == "'jump' keeps 2 operators on one core"


# ------------------------------------------------------------------ separation

kinds = st.sampled_from(sorted(AIRFRAMES))


def _pack(rows: Any, sizes: Any) -> list[bytes]:
    """Positions and velocities, (n, 6), as each core packs its own; they begin at these rows."""
    return [FleetMotion.pack(rows[a:b, :3], rows[a:b, 3:]) for a, b in pairwise(sizes)]


def _watch(rows: Any, core: list[int], kind: str, lag: int) -> Any:
    """A separation of aircraft with these positions and velocities, whose names order them as given."""
    order = np.argsort(core, kind="stable")
    parts = [[f"v{row:03}" for row in order.tolist() if core[row] == one] for one in sorted({0, 1, *core})]
    motion = FleetMotion(parts)
    sizes = np.cumsum([0, *map(len, parts)])
    ordered = rows[order]
    motion.update(_pack(ordered, sizes))
    return Separation(motion, [AIRFRAMES[kind]] * len(core), PERIOD_NS, (1 + lag) * PERIOD_NS), motion, parts, order


closing = st.tuples(st.floats(0.0, 14.0), st.floats(0.0, 60.0), st.floats(0.0, 6.3))


@given(st.lists(closing, min_size=1, max_size=4), kinds, st.integers(0, 1), st.data())
@settings(deadline=None)  # the first example compiles
def test_aircraft_that_touch_were_announced_at_the_barrier_before(
    pairs: list[tuple[float, float, float]], kind: str, lag: int, data: st.DataObject
) -> None:
    """Pairs on different cores fly at each other, pushed within the bounds: who touches was named before, though what
    is checked at a barrier is what was seen `lag` barriers before.
    """
    rows = []
    for number, (gap_m, speed_mps, way) in enumerate(pairs):
        along = np.array([np.cos(way), np.sin(way), 0.0])
        apart = 2 * AIRFRAMES[kind].radius_m + gap_m
        here = np.array([100.0 * number, 0.0, 10.0])
        rows += [[*here, *(0.5 * speed_mps * along)], [*(here + apart * along), *(-0.5 * speed_mps * along)]]
    core = [0, 1] * len(pairs)
    separation, motion, parts, order = _watch(np.array(rows), core, kind, lag)
    period, shape = PERIOD_NS / NS_PER_S, AIRFRAMES[kind]
    state = np.array(rows)[order]
    sizes = np.cumsum([0, *map(len, parts)])
    seen = [state] * (1 + lag)
    for _ in range(24):
        motion.update(_pack(seen[-1 - lag], sizes))
        announced = separation.check()
        if announced is not None:
            assert core[int(announced.vehicle[1:])] != core[int(announced.other[1:])]
            return
        push = np.array(data.draw(st.lists(st.floats(-50, 50), min_size=3, max_size=3)))
        state = state.copy()
        state[:, :3] += state[:, 3:] * period + 0.5 * push * period**2
        state[:, 3:] += push * period
        for a in range(sizes[1]):
            for b in range(sizes[1], len(state)):
                across = np.hypot(*(state[a, :2] - state[b, :2]))
                up = abs(state[a, 2] - state[b, 2])
                assert across > 2 * shape.radius_m or up > shape.height_m
        seen.append(state)


@pytest.mark.parametrize("kind", sorted(AIRFRAMES))
def test_no_airframe_accelerates_faster_than_is_assumed(kind: str) -> None:
    airframe = AIRFRAMES[kind]
    thrust = MOTORS * airframe.thrust_ns2 * airframe.rotor_max_radps**2
    drag = 0.5 * 1.225 * airframe.drag_area_m2 * 60.0**2
    assert (thrust + drag) / airframe.mass_kg + GRAVITY_MPS2 < ACCELERATION_MPS2
    assert 30.0 * airframe.cg_height_m < TUMBLING_MPS


def test_the_benchmark_is_divided_before_it_is_pinned(monkeypatch: pytest.MonkeyPatch) -> None:
    """`divide` asks for the CPUs of the process: of a pinned one there is only one."""

    class StopHere(Exception):  # noqa: N818
        pass

    pinned: list[object] = []

    def note(*_: object) -> Division:
        assert pinned == []
        raise StopHere

    monkeypatch.setattr(os, "sched_setaffinity", lambda *cpus: pinned.append(cpus))
    monkeypatch.setattr(bench_cores, "divide", note)
    with pytest.raises(StopHere):
        bench_cores._flown(4, 1.0, FleetOptions(operators=2), [0, 1])


def test_each_repetition_of_the_benchmark_begins_with_another_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """CPUs may differ in speed, and the run on one core must not always have the quicker one."""
    used: list[list[int]] = []

    def note(*arguments: object) -> dict[str, float]:
        used.append(arguments[-1])  # type: ignore[arg-type]
        return {"evaluation_s": 0.0}

    monkeypatch.setattr(bench_cores, "available_cpus", lambda: [2, 5, 7])
    monkeypatch.setattr(bench_cores, "run_in_process", note)
    for turn in range(4):
        for cores in (1, 2):
            bench_cores.measure(4, 1.0, cores, FleetOptions(operators=2), turn=turn)
    assert used == [[2], [2, 5], [5], [5, 7], [7], [7, 2], [2], [2, 5]]
