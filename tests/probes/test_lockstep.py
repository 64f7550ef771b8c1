"""Probe (g): three lockstep engines, one of which falls silent."""

from __future__ import annotations

import pytest

from skyrange.core.errors import ComponentError, InputError
from skyrange.core.time import NEVER, NS_PER_S
from skyrange.kernel import EngineMount, Kernel, Wiring
from tests.probes.toys import MS, Bodies, Climber, Log, Station, onboard

VEHICLES = ["blue/b1", "blue/b2", "blue/b3"]
QUANTUM = 2_500_000


def build(engines: list[Climber], *, policy: str = "stop", unready: str = "fail") -> tuple[Kernel, Log]:
    links, routes = [], []
    for vehicle in VEHICLES:
        some_links, some_routes = onboard(vehicle)
        links += some_links
        routes += some_routes
    log = Log()
    mounts = [EngineMount(e, slice(i, i + 1)) for i, e in enumerate(engines)]
    wiring = Wiring(
        seed=1,
        links=links,
        routes=routes,
        agents=[Station("blue", VEHICLES)],
        world=Bodies(VEHICLES, QUANTUM),
        engines=mounts,
        on_silent=policy,
        on_unready=unready,
    )
    return Kernel(wiring, [log]), log


def test_engines_stay_in_lockstep_and_the_silent_one_is_named() -> None:
    engines = [Climber(f"e{i}", [v], falls_silent=(VEHICLES[1], NS_PER_S)) for i, v in enumerate(VEHICLES)]
    kernel, log = build(engines)
    with pytest.raises(ComponentError, match=r"blue/b2 \(silent\).*1\.0000 s") as caught:
        kernel.advance(2 * NS_PER_S)
    assert caught.value.exit_code == 3
    assert engines[0].begun == engines[1].begun == engines[2].begun
    assert engines[0].begun[-1] == NS_PER_S, "nobody was asked to go beyond the step that was not answered"
    assert [row[2:4] for row in log.notes] == [("event.engine_silent", "blue/b2")]
    assert any(row[3] == "blue/b2.autopilot" for row in log.frames), "what came before is recorded"


def test_the_others_go_on_where_the_scenario_says_so() -> None:
    engines = [Climber(f"e{i}", [v], falls_silent=(VEHICLES[1], NS_PER_S)) for i, v in enumerate(VEHICLES)]
    kernel, log = build(engines, policy="continue")
    kernel.advance(2 * NS_PER_S)
    kernel.finish()
    assert [row[:4] for row in log.notes] == [(NS_PER_S, "e1", "event.engine_silent", "blue/b2")]
    last_sent = {v: max(row[0] for row in log.frames if row[3] == f"{v}.autopilot") for v in VEHICLES}
    assert last_sent["blue/b2"] < NS_PER_S <= last_sent["blue/b1"]
    assert engines[0].begun[-1] == 2 * NS_PER_S


def test_the_world_moves_under_the_last_actuators() -> None:
    kernel, log = build([Climber(f"e{i}", [v]) for i, v in enumerate(VEHICLES)])
    kernel.advance(100 * MS)
    assert log.truth[-1][0] == 100 * MS
    heights = memoryview(log.truth[-1][1]["up_m"]).cast("d").tolist()
    assert heights == pytest.approx([0.1, 0.1, 0.1], abs=1e-12)


def test_preroll_is_negative_time_and_an_unready_engine_is_named() -> None:
    engines = [Climber(f"e{i}", [v], preroll_ns=300 * MS, boots_at=-50 * MS) for i, v in enumerate(VEHICLES)]
    kernel, log = build(engines)
    kernel.advance(0)
    assert engines[0].begun[0] == -300 * MS
    assert [row[2] for row in log.notes] == ["event.engine_ready"] * 3

    late = [Climber(f"e{i}", [v], preroll_ns=300 * MS, boots_at=100 * MS) for i, v in enumerate(VEHICLES)]
    kernel, _ = build(late)
    with pytest.raises(ComponentError, match=r"e0: blue/b1 still booting at time 0"):
        kernel.advance(NS_PER_S)
    kernel, log = build(
        [Climber(f"e{i}", [v], preroll_ns=300 * MS, boots_at=100 * MS) for i, v in enumerate(VEHICLES)], unready="wait"
    )
    kernel.advance(NS_PER_S)
    assert [row[0] for row in log.notes if row[2] == "event.engine_ready"] == [100 * MS] * 3


def test_unknown_policies_are_refused() -> None:
    with pytest.raises(InputError, match=r"on_silent.*'shrug'.*stop or continue"):
        build([Climber("e", ["blue/b1"])], policy="shrug")


def test_an_observer_alters_not_when_another_sees_truth() -> None:
    def seen(*others: int) -> list[int]:
        kernel, log = build([Climber("one", ["blue/b1"]), Climber("two", ["blue/b2"]), Climber("three", ["blue/b3"])])
        beside = [Log() for _ in others]
        for each, period in zip(beside, others, strict=True):
            each.truth_period_ns = period
        log.truth_period_ns = 100 * MS
        kernel.set_observers([log, *beside])
        kernel.advance(NS_PER_S)
        return [time for time, _ in log.truth if time % (100 * MS) == 0]

    assert seen() == [100 * MS * tick for tick in range(11)]
    assert seen(70 * MS) == seen()
    assert seen(NEVER, 7) == seen()
