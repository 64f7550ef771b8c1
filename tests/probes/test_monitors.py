"""Monitors see what comes and goes at their ends, on fused routes too, and leave no trace but their alerts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import Agent
from skyrange.contracts.frames import Fate, Frame
from skyrange.contracts.links import Act, Channel, TapPlacement
from skyrange.contracts.monitors import MonitorPlacement, ObservedFrame, ObservedFrames
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.ids import Port, originator_id
from skyrange.core.time import NS_PER_S, Time
from skyrange.kernel import Kernel, Wiring
from skyrange.record.write.memory_observer import MemoryObserver
from tests.probes import test_blocks, test_made_of, test_taps
from tests.probes.toys import MS, ROUGH, Fleet, Log, Station, onboard

pytestmark = pytest.mark.rotating

VEHICLES = ("blue/b1", "blue/b2")
END = NS_PER_S


@dataclass
class Keeper:
    """Keeps all that it is handed; alerts of each batch, so that alerts tell what was seen."""

    service_ns: Time = 30 * MS
    seen: list[tuple[Time, list[ObservedFrame]]] = field(default_factory=list)

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        columns = zip(
            [frames.ports[place] for place in frames.places.tolist()],
            frames.received.tolist(),
            frames.at_ns.tolist(),
            frames.payloads,
            [frames.names[name] for name in frames.src.tolist()],
            [frames.names[name] for name in frames.dst.tolist()],
            strict=True,
        )
        assert list(frames) == [ObservedFrame(*row) for row in columns]
        self.seen.append((now, list(frames)))
        return [Alert(now, "batch", "kept", float(len(frames)), {"frames": repr(list(frames))})]

    @property
    def frames(self) -> list[ObservedFrame]:
        return [frame for _, batch in self.seen for frame in batch]


def everywhere(keeper: Callable[[], Any] = Keeper) -> MonitorPlacement:
    return MonitorPlacement("all", keeper, ["*"], "*")


def range_wiring(gcs: Channel | None, tapped: bool = False, **more: Any) -> Wiring:
    links, routes = [], []
    for vehicle in VEHICLES:
        some_links, some_routes = onboard(vehicle, gcs)
        links += some_links
        routes += some_routes
    if tapped:
        sides = [("gcs:*", "gcs"), ("gcs:*", "companion"), ("log:*", "proxy")]
        more["taps"] = [TapPlacement(match, side, test_taps.Meddler, "mitm") for match, side in sides]
        more["acts"] = [Act("mitm", start_ns=300 * MS)]
    agents: list[Agent] = [Station("blue", VEHICLES), Fleet("fleet", VEHICLES)]
    return Wiring(5, links, agents, routes, **more)


def voices_wiring(gcs: Channel | None, tapped: bool = False) -> Wiring:
    """Companions that speak where they forward."""
    plan = range_wiring(gcs, tapped)
    return replace(plan, agents=[*plan.agents, *(test_made_of.Voice(vehicle, True, 35 * MS) for vehicle in VEHICLES)])


def blocks_wiring(gcs: Channel | None, tapped: bool = False) -> Wiring:
    return test_blocks.wiring(True, gcs=gcs, tapped=test_blocks.NAMES[2] if tapped else "")


WIRINGS = [range_wiring, voices_wiring, blocks_wiring]


def flown(plan: Wiring, ends: Sequence[Time] = (END,), observer: Any = None) -> tuple[Any, Kernel]:
    observer = observer or MemoryObserver()
    kernel = Kernel(plan, [observer])
    for end in ends:
        kernel.advance(end)
    kernel.finish()
    return observer, kernel


def seen_by(kernel: Kernel) -> Keeper:
    (slot,) = kernel._runs[0].monitors.slots
    assert isinstance(slot.monitor, Keeper)
    return slot.monitor


def expected(plan: Wiring, frames: Sequence[Frame], ports: set[Port], until: Time) -> list[tuple[Any, ...]]:
    """What should be seen at `ports`, worked out from what the observers are told."""
    found = []
    for frame in frames:
        spec = next(spec for spec in plan.links if spec.name == frame.link)
        src, dst = (spec.a, spec.b) if frame.direction == "fwd" else (spec.b, spec.a)
        claims = (frame.payload, frame.src, frame.dst)
        order = (frame.sender, frame.serial)
        if Port(src, frame.link) in ports and frame.sender in (src, originator_id(src)) and frame.sent_ns <= until:
            found.append((frame.sent_ns, frame.link, src, 0, *order, *claims))
        if Port(dst, frame.link) in ports and frame.fate is Fate.DELIVERED and frame.arrived_ns <= until:
            found.append((frame.arrived_ns, frame.link, dst, 1, *order, *claims))
    found.sort(key=lambda row: row[:6])
    return [(at, link, end, bool(way), *rest[2:]) for at, link, end, way, *rest in found]


def told(frames: Sequence[ObservedFrame]) -> list[tuple[Any, ...]]:
    return [(f.at, f.port.link, f.port.endpoint, f.received, f.payload, f.src, f.dst) for f in frames]


@pytest.mark.parametrize("make", WIRINGS)
@pytest.mark.parametrize("tapped", [False, True])
@pytest.mark.parametrize("gcs", [None, ROUGH, Channel(latency_ns=9 * MS, jitter_ns=5 * MS, loss=0.1)])
def test_it_sees_what_its_ends_see_when_they_see_it(make: Any, tapped: bool, gcs: Channel | None) -> None:
    for links, side in ((["*"], "*"), (["gcs:*"], "gcs"), (["log:*", "gcs:blue/b1"], "*.companion")):
        plan = replace(make(gcs, tapped), monitors=[MonitorPlacement("all", Keeper, links, side)])
        observer, kernel = flown(plan)
        keeper = seen_by(kernel)
        ports = set(kernel._runs[0].monitors.slots[0].collector.ports)
        last = END - END % keeper.service_ns
        assert told(keeper.frames) == expected(plan, observer.frames, ports, last)
        assert len(keeper.frames) > 20
        before = -1
        for now, frames in keeper.seen:
            assert all(before < frame.at <= now for frame in frames)
            before = now
        assert [now for now, _ in keeper.seen] == list(range(0, END + 1, keeper.service_ns))


@pytest.mark.parametrize("make", WIRINGS)
@pytest.mark.parametrize("tapped", [False, True])
def test_nothing_shows_that_it_was_there(make: Any, tapped: bool) -> None:
    without, _ = flown(make(None, tapped), observer=Log())
    watched, kernel = flown(replace(make(None, tapped), monitors=[everywhere()]), observer=Log())
    assert watched.table() == without.table()
    assert (watched.notes, watched.labels) == (without.notes, without.labels)
    assert (len(without.alerts), len(watched.alerts) > 30) == (0, True)
    alone = Kernel(make(None, tapped))
    fused = {name for name, link in alone._runs[0].links.items() if link.fused or link.staged}
    assert fused == {name for name, link in kernel._runs[0].links.items() if link.fused or link.staged}
    assert fused or tapped


@pytest.mark.parametrize("make", WIRINGS)
@pytest.mark.parametrize("tapped", [False, True])
def test_it_sees_the_same_fused_or_not_and_however_time_is_cut(make: Any, tapped: bool) -> None:
    monitors = [everywhere()]
    straight, _ = flown(replace(make(None, tapped), monitors=monitors))
    unfused, _ = flown(replace(make(None, tapped), monitors=monitors, fuse=False))
    in_steps, _ = flown(replace(make(None, tapped), monitors=monitors), [*range(0, END, 7 * MS), END])
    assert len(straight.alerts) > 30
    assert unfused.alerts == straight.alerts
    assert in_steps.alerts == straight.alerts


def test_blocks_and_singles_look_alike() -> None:
    in_blocks, singly = (
        flown(replace(test_blocks.wiring(blocks), monitors=[everywhere()]), (test_blocks.END,))[0]
        for blocks in (True, False)
    )
    assert in_blocks.alerts == singly.alerts


def test_it_learns_neither_true_senders_nor_fates() -> None:
    assert ObservedFrame._fields == ("port", "received", "at", "payload", "src", "dst")
    plan = replace(range_wiring(None, tapped=True), monitors=[everywhere()])
    observer, kernel = flown(plan)
    forged = [frame for frame in observer.frames if "@" in frame.sender and frame.fate is Fate.DELIVERED]
    assert forged
    names = {name for frame in seen_by(kernel).frames for name in (frame.src, frame.dst)}
    assert not any("@" in name for name in names)


def test_a_fork_goes_on_with_a_monitor_of_its_own() -> None:
    for make in WIRINGS:
        straight, _ = flown(replace(make(None), monitors=[everywhere()]))
        stem = MemoryObserver()
        kernel = Kernel(replace(make(None), monitors=[everywhere()]), [stem])
        kernel.advance(435 * MS)
        branch = MemoryObserver()
        twin = kernel.fork([branch])
        twin.advance(END)
        kernel.advance(END)
        assert stem.alerts == straight.alerts
        assert branch.alerts == [alert for alert in straight.alerts if alert.time_ns > 435 * MS]


def test_each_kernel_of_a_range_sees_the_ends_that_live_there() -> None:
    _, kernel = flown(replace(range_wiring(None), monitors=[everywhere()]))
    frames = seen_by(kernel).frames
    ground = {"blue.gcs"}
    air = {f"{vehicle}.{role}" for vehicle in VEHICLES for role in ("autopilot", "proxy", "companion")}
    plan = range_wiring(None)
    placements = [everywhere(), MonitorPlacement("station", Keeper, ["gcs:*"], "gcs")]
    parts = []
    for own in (ground, air):
        agents = [agent for agent in plan.agents if (agent.name == "fleet") == (own is air)]
        routes = plan.routes if own is air else ()
        parts.append(Kernel(replace(plan, agents=agents, routes=routes, local=own, monitors=placements, fuse=False)))
    inbound: list[list[Any]] = [[], []]
    for now in range(0, END + 1, 5 * MS):  # shorter than any latency between the two
        sent = [part.advance(now, inbound[k]) for k, part in enumerate(parts)]
        inbound = [[t for t in sent[1 - k] if t.arrival > now] for k in range(2)]
    both = [{slot.id: slot for slot in part._runs[0].monitors.slots} for part in parts]
    assert [set(slots) for slots in both] == [{"all", "station"}, {"all"}]
    for slots, own in zip(both, (ground, air), strict=True):
        keeper: Any = slots["all"].monitor
        assert told(keeper.frames) == told([frame for frame in frames if frame.port.endpoint in own])


def test_what_stood_still_is_served_once() -> None:
    plan = replace(range_wiring(None), fuse=False, monitors=[everywhere()])
    kernel = Kernel(plan)
    kernel.advance(100 * MS)
    kernel.skip(500 * MS)
    kernel.advance(END)
    times = [now for now, _ in seen_by(kernel).seen]
    assert times == [*range(0, 101 * MS, 30 * MS), *range(510 * MS, END + 1, 30 * MS)]


@pytest.mark.parametrize(
    ("placement", "where"),
    [
        (MonitorPlacement("d", Keeper, ["gcs:red/*"], "gcs"), r"monitors\.d\.links: gcs:red/\*"),
        (MonitorPlacement("d", Keeper, ["gcs:*"], "autopilot"), r"monitors\.d\.side: autopilot"),
        (MonitorPlacement("d", lambda: Keeper(0), ["gcs:*"], "gcs"), r"monitors\.d\.service_ns: 0"),
        (MonitorPlacement("d d", Keeper, ["gcs:*"], "gcs"), "letters, digits"),
    ],
)
def test_a_placement_that_fits_nothing_is_refused(placement: MonitorPlacement, where: str) -> None:
    with pytest.raises(InputError, match=where):
        Kernel(replace(range_wiring(None), monitors=[placement]))


def test_two_of_one_id_are_refused() -> None:
    with pytest.raises(InputError, match="monitors: all"):
        Kernel(replace(range_wiring(None), monitors=[everywhere(), everywhere()]))


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (None, "a list of alerts was expected"),
        (Alert(0, "a", "b", 1.0), "a list of alerts was expected"),
        (["alert"], "an Alert was expected"),
        ([Alert(NS_PER_S, "a", "b", 1.0)], "not later"),
        ([Alert(0.0, "a", "b", 1.0)], "a whole number of ns"),  # type: ignore[arg-type]
        ([Alert(0, "a", "b", float("inf"))], "a finite number"),
        ([Alert(0, "", "b", 1.0)], "text was expected"),
        (ZeroDivisionError(), "ZeroDivisionError"),
    ],
)
def test_one_that_breaks_its_contract_is_blamed(answer: Any, said: str) -> None:
    class Broken(Keeper):
        def observe(self, now: Time, frames: ObservedFrames) -> Any:
            if isinstance(answer, Exception):
                raise answer
            return answer

    kernel = Kernel(replace(range_wiring(None), monitors=[everywhere(Broken)]))
    with pytest.raises(ComponentError, match=f"detector all: .*{said}"):
        kernel.advance(END)


def test_what_it_is_handed_can_be_narrowed() -> None:
    _, kernel = flown(replace(range_wiring(None), monitors=[everywhere()]))
    ports = kernel._runs[0].monitors.slots[0].collector.ports
    assert list(ports) == sorted(ports, key=lambda port: (port.link, port.endpoint))

    class Narrow(Keeper):
        def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
            some = frames.take(frames.received)
            assert list(some) == [frame for frame in frames if frame.received]
            assert list(some.take(np.arange(len(some))[::-1])) == list(some)[::-1]
            assert frames[:2] == list(frames)[:2]
            return ()

    flown(replace(range_wiring(None), monitors=[everywhere(Narrow)]))
