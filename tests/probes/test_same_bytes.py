"""Probes (c), (d), (e): forking, splitting an agent and splitting the kernel change no byte."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from skyrange.contracts.components import Agent
from skyrange.contracts.links import Act, Channel, LinkSpec, Route, TapPlacement
from skyrange.core.time import NS_PER_S, Time
from skyrange.kernel import EngineMount, Kernel, Transit, Wiring
from tests.probes.test_taps import Meddler
from tests.probes.toys import MS, ROUGH, Bodies, Climber, Fleet, Log, Station, onboard

END = 3 * NS_PER_S


def network(vehicles: Sequence[str], gcs: Channel | None) -> tuple[list[LinkSpec], list[Route]]:
    links: list[LinkSpec] = []
    routes: list[Route] = []
    for vehicle in vehicles:
        some_links, some_routes = onboard(vehicle, gcs)
        links += some_links
        routes += some_routes
    return links, routes


def stations(vehicles: Sequence[str]) -> list[Station]:
    operators = sorted({v.split("/")[0] for v in vehicles})
    return [Station(op, [v for v in vehicles if v.startswith(op + "/")]) for op in operators]


@pytest.mark.parametrize("fork_at", [0, 637_500_000, 2 * NS_PER_S])
def test_a_fork_equals_the_straight_run(fork_at: Time) -> None:
    vehicles = [f"blue/b{i}" for i in range(4)]
    links, routes = network(vehicles, ROUGH)

    def build(log: Log) -> Kernel:
        return Kernel(
            Wiring(
                seed=5,
                links=links,
                routes=routes,
                agents=stations(vehicles),
                taps=[TapPlacement("gcs:blue/b1", "companion", Meddler, "mitm")],
                acts=[Act("mitm", start_ns=500 * MS)],
                world=Bodies(vehicles),
                engines=[EngineMount(Climber("climbers", vehicles), slice(None))],
            ),
            [log],
        )

    straight = Log()
    kernel = build(straight)
    kernel.advance(END)
    kernel.finish()

    first, second = Log(), Log()
    trunk = build(first)
    trunk.advance(fork_at)
    seen = len(first.frames), len(first.notes), len(first.labels), len(first.truth)
    branch = trunk.fork([second])
    for part in (trunk, branch):
        part.advance(END)
        part.finish()
    assert first.table() == straight.table()
    assert first.notes == straight.notes
    assert first.labels == straight.labels
    assert first.truth == straight.truth
    assert second.frames == first.frames[seen[0] :]
    assert second.notes == first.notes[seen[1] :]
    assert second.labels == first.labels[seen[2] :]
    assert second.truth == first.truth[seen[3] :]


@pytest.mark.parametrize("gcs", [None, ROUGH], ids=["fixed", "rough"])
def test_splitting_a_fleet_agent_changes_no_byte(gcs: Channel | None) -> None:
    vehicles = [f"{'blue' if i % 2 else 'green'}/v{i:03d}" for i in range(100)]
    links, routes = network(vehicles, gcs)

    def fly(fleets: list[Fleet]) -> tuple[Log, list[Station]]:
        log = Log()
        ground = stations(vehicles)
        kernel = Kernel(Wiring(seed=3, links=links, routes=routes, agents=[*ground, *fleets]), [log])
        kernel.advance(NS_PER_S)
        kernel.finish()
        return log, ground

    whole, ground = fly([Fleet("all", vehicles)])
    parts, ground_parts = fly([Fleet(f"part {k}", vehicles[25 * k : 25 * k + 25]) for k in reversed(range(4))])
    assert whole.table() == parts.table()
    assert [s.heard for s in ground] == [s.heard for s in ground_parts]
    assert len(whole.frames) > 10_000


def test_registration_order_changes_no_byte() -> None:
    vehicles = [f"blue/b{i}" for i in range(6)]
    links, routes = network(vehicles, ROUGH)
    logs = []
    for turn in (1, -1):
        log = Log()
        agents: list[Agent] = [*stations(vehicles), Fleet("x", vehicles[:3]), Fleet("a", vehicles[3:])]
        kernel = Kernel(Wiring(seed=3, links=links[::turn], routes=routes[::turn], agents=agents[::turn]), [log])
        kernel.advance(NS_PER_S)
        kernel.finish()
        logs.append(log)
    assert logs[0].frames == logs[1].frames
    assert logs[0].notes == logs[1].notes


@pytest.mark.parametrize("barrier", [20 * MS, 7 * MS], ids=["least latency", "shorter"])
@pytest.mark.parametrize("gcs", [None, ROUGH], ids=["fixed", "rough"])
def test_two_kernels_with_a_barrier_equal_one(gcs: Channel | None, barrier: Time) -> None:
    vehicles = [f"blue/b{i}" for i in range(3)]
    links, routes = network(vehicles, gcs)

    def wiring(agents: Sequence[object], **more: object) -> Wiring:
        return Wiring(
            seed=8,
            links=links,
            agents=agents,  # type: ignore[arg-type]
            taps=[TapPlacement("gcs:blue/b1", side, Meddler, "mitm") for side in ("gcs", "companion")],
            acts=[Act("mitm")],
            **more,  # type: ignore[arg-type]
        )

    one = Log()
    kernel = Kernel(wiring([*stations(vehicles), Fleet("fleet", vehicles)], routes=routes), [one])
    kernel.advance(END)
    kernel.finish()

    ground_log, air_log = Log(), Log()
    ground_side = {"blue.gcs"}
    air_side = {f"{v}.{role}" for v in vehicles for role in ("autopilot", "proxy", "companion")}
    ground = Kernel(wiring(stations(vehicles), local=ground_side), [ground_log])
    air = Kernel(wiring([Fleet("fleet", vehicles)], routes=routes, local=air_side), [air_log])
    to_air: list[Transit] = []
    to_ground: list[Transit] = []
    exchanged = 0
    now = -1  # nothing has happened yet, not even the instant 0
    while now < END:
        now = min(now + barrier, END)
        from_ground = ground.advance(now, to_ground)
        from_air = air.advance(now, to_air)
        to_air, to_ground = from_ground, from_air
        exchanged += len(from_ground) + len(from_air)
    for side, inbound in ((ground, to_ground), (air, to_air)):
        side.advance(END, inbound)
        side.finish()
    assert exchanged > 100
    both = sorted(ground_log.frames + air_log.frames, key=lambda row: row[:5])
    assert both == one.table()
    assert sorted(ground_log.labels + air_log.labels, key=str) == sorted(one.labels, key=str)
    assert sorted(ground_log.notes + air_log.notes, key=str) == sorted(one.notes, key=str)
