"""Benchmarks of the suite: the cases of each with their default sizes, its measures, and what has to be installed.

Every case measures in processes of its own. A row's yardsticks are a cost in units of the yardstick of `bench fleet`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from skyrange.bench import approval, ardupilot, attacks, cores, fleet, live, planning, radio, rays, transports
from skyrange.bench.fleet import FleetOptions
from skyrange.bench.isolation import run_in_process
from skyrange.bench.suite.results import Better, Measure
from skyrange.core.errors import InputError, nearest
from skyrange.core.extras import require_extra

__all__ = ["BENCHMARKS", "Benchmark", "Case", "find_benchmarks"]

RawRow = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Case:
    """One case: `measure` starts the processes, waits for them, and returns the rows."""

    name: str
    measure: Callable[[], Sequence[RawRow]]


@dataclass(frozen=True, slots=True)
class Quantity:
    """A measure of a row: `of` computes it from the row and the yardstick in microseconds, `None` if it has none."""

    name: str
    unit: str
    better: Better
    of: Callable[[RawRow, float], float | None]
    relative: bool = False

    def measure(self, row: RawRow, yardstick_us: float) -> Measure:
        """The measure of a row; without a value if it is no finite number."""
        value = self.of(row, yardstick_us)
        if value is not None:
            value = float(f"{value:.5g}") if math.isfinite(value) else None
        return Measure(name=self.name, unit=self.unit, better=self.better, relative=self.relative, value=value)


@dataclass(frozen=True, slots=True)
class Benchmark:
    """A benchmark: what it measures, its cases, those of `--quick`, and the key that names its rows, "" for one row."""

    name: str
    about: str
    quantities: tuple[Quantity, ...]
    cases: tuple[Case, ...]
    quick: tuple[Case, ...]
    row_key: str = ""
    require: Callable[[], object] = lambda: None
    """Raises `SkyrangeError` if something that it needs is not installed."""


def find_benchmarks(names: Sequence[str]) -> list[Benchmark]:
    """The benchmarks of these names in the order of `BENCHMARKS`; all without names. Raises `InputError`."""
    known = [benchmark.name for benchmark in BENCHMARKS]
    for name in names:
        if name not in known:
            hint = nearest(name, known) or f"Known: {', '.join(known)}."
            raise InputError.one("bench all", "--only", name, "the name of a benchmark", hint)
    return [benchmark for benchmark in BENCHMARKS if not names or benchmark.name in names]


# --- quantities ------------------------------------------------------------------------------------


def _key(key: str, scale: float = 1.0) -> Callable[[RawRow, float], float | None]:
    """The value of a key times `scale`."""

    def of(row: RawRow, yardstick_us: float) -> float | None:
        value = row.get(key)
        return None if value is None else value * scale

    return of


def _yardsticks(key: str, us: float) -> Callable[[RawRow, float], float | None]:
    """A key in units of `us` microseconds, as a multiple of the row's own yardstick if it has one."""

    def of(row: RawRow, yardstick_us: float) -> float | None:
        value = row.get(key)
        return None if value is None else value * us / row.get("yardstick_us", yardstick_us)

    return of


def _yardsticks_each(key: str) -> Callable[[RawRow, float], float | None]:
    """The time of one of so many a second, in yardsticks."""

    def of(row: RawRow, yardstick_us: float) -> float | None:
        return 1e6 / row[key] / row.get("yardstick_us", yardstick_us) if row.get(key) else None

    return of


_FACTOR: Final = "speed"
"""Name of the measures that are simulated seconds over wall or processor seconds."""
_FLEET: Final = (
    Quantity(_FACTOR, "×", "higher", _key("total_factor")),
    Quantity("speed of flight", "×", "higher", _key("real_time_factor")),
    Quantity("an aircraft-second", "yardsticks", "lower", _key("yardsticks"), relative=True),
    Quantity("set-up", "s", "lower", _key("setup_s")),
    Quantity("flight", "s", "lower", _key("wall_s")),
    Quantity("tables", "s", "lower", _key("finalise_s")),
    Quantity("peak memory", "MB", "lower", _key("memory_mb", 1.048576)),
    Quantity("disk", "MB", "lower", _key("disk_mb")),
    Quantity("a frame and hop", "bytes", "lower", _key("bytes_per_frame"), relative=True),
)
_CORES: Final = (
    Quantity(_FACTOR, "×", "higher", _key("total_factor")),
    Quantity("speed of flight", "×", "higher", _key("real_time_factor")),
    Quantity("all, times as fast as on one core", "×", "higher", _key("speed_up"), relative=True),
    Quantity("flight, times as fast as on one core", "×", "higher", _key("flight_speed_up"), relative=True),
)
_RADIO: Final = (
    Quantity(_FACTOR, "×", "higher", _key("real_time_factor")),
    Quantity("a radio-second", "yardsticks", "lower", _yardsticks("us_per_node_s", 1.0), relative=True),
    Quantity("receptions per CPU second", "1/s", "higher", _key("receptions_per_s")),
)
_ROUTES: Final = (
    Quantity("a route", "yardsticks", "lower", _yardsticks("cpu_ms", 1e3), relative=True),
    Quantity("time, median", "ms", "lower", _key("p50_ms")),
    Quantity("time, 95 %", "ms", "lower", _key("p95_ms")),
    Quantity("length over straight length", "×", "lower", _key("detour"), relative=True),
)
_RAYS: Final = (
    Quantity("a ray", "yardsticks", "lower", _yardsticks_each("rays_per_s"), relative=True),
    Quantity("rays per core", "1/s", "higher", _key("rays_per_s")),
    Quantity("ten LiDARs at 10 Hz, times real time", "×", "higher", _key("lidar_factor")),
    Quantity("a depth camera at 10 Hz, times real time", "×", "higher", _key("depth_factor")),
)
_ANSWERS: Final = (
    Quantity("decisions", "1/s", "higher", _key("decisions_per_s")),
    Quantity("answer, median", "ms", "lower", _key("p50_ms")),
    Quantity("answer, 99 %", "ms", "lower", _key("p99_ms")),
)
_DECISIONS: Final = (
    Quantity("a decision", "yardsticks", "lower", _yardsticks("cpu_ms", 1e3), relative=True),
    *_ANSWERS,
)
_ATTACKS: Final = (
    Quantity("speed of flight", "×", "higher", _key("real_time_factor")),
    Quantity("of the speed without an attack", "%", "higher", _key("speed", 100.0), relative=True),
    Quantity("a frame", "yardsticks", "lower", _yardsticks("us_per_frame", 1.0), relative=True),
)
_TRANSPORTS: Final = (
    Quantity("a frame", "yardsticks", "lower", _yardsticks_each("frames_per_core_s"), relative=True),
    Quantity("frames per core", "1/s", "higher", _key("frames_per_core_s")),
    Quantity("latency, median", "ms", "lower", _key("added_ms")),
    Quantity("latency, 99 %", "ms", "lower", _key("added_p99_ms")),
)
_LIVE: Final = (
    Quantity("an aircraft-second", "yardsticks", "lower", _yardsticks_each("aircraft_per_core"), relative=True),
    Quantity("aircraft per core", "", "higher", _key("aircraft_per_core")),
    Quantity("largest delay", "s", "lower", _key("max_lag_s")),
)
_ARDUPILOT: Final = (
    Quantity(_FACTOR, "×", "higher", _key("real_time_factor")),
    Quantity("skyrange over ArduPilots alone", "×", "lower", _key("ours_over_bare"), relative=True),
    Quantity("both over ArduPilots alone", "×", "lower", _key("over_bare"), relative=True),
    Quantity("an aircraft-second", "yardsticks", "lower", _yardsticks_each("per_core"), relative=True),
    Quantity("aircraft per core in real time", "", "higher", _key("per_core")),
)


# --- cases -----------------------------------------------------------------------------------------


def _aircraft(count: int, seconds: float) -> str:
    return f"{count:,} aircraft, {seconds:g} s"


def _fleets(sizes: Sequence[tuple[int, float]], options: FleetOptions) -> tuple[Case, ...]:
    def fly(count: int, seconds: float) -> list[RawRow]:
        return [fleet.measure(count, seconds, options)]

    return tuple(Case(_aircraft(*size), partial(fly, *size)) for size in sizes)


def _on_cores(sizes: Sequence[tuple[int, float]], *, remote_id: bool) -> tuple[Case, ...]:
    def fly(count: int, seconds: float) -> list[RawRow]:
        options = FleetOptions(remote_id=remote_id, operators=4)
        rows = [cores.measure(count, seconds, number, options) for number in (1, 2)]
        compared = {medians["cores"]: medians for medians in cores.compare(rows)}
        names = {1: "one core", 2: "two cores"}
        return [{**compared[row["cores"]], **row, "on": names[row["cores"]]} for row in rows]

    name = ", Remote ID" if remote_id else ""
    return tuple(Case(f"{_aircraft(*size)}{name}", partial(fly, *size)) for size in sizes)


def _require_cores() -> None:
    cores.check_cores([2])


def _radios(sizes: Sequence[tuple[int, float]], engine: str) -> tuple[Case, ...]:
    def drive(count: int, seconds: float) -> list[RawRow]:
        return [run_in_process(f"bench with {count} radios", radio.measure, count, seconds, 500.0, engine)]

    return tuple(Case(f"{count:,} radios, {seconds:g} s", partial(drive, count, seconds)) for count, seconds in sizes)


def _decisions(sizes: Sequence[tuple[int, int]]) -> tuple[Case, ...]:
    def decide(active: int, requests: int) -> list[RawRow]:
        return [run_in_process("bench of approval", approval.measure, active, requests)]

    return tuple(
        Case(f"{active:,} accepted flights, {requests:,} requests", partial(decide, active, requests))
        for active, requests in sizes
    )


def _services(requests: int) -> tuple[Case, ...]:
    def ask(name: str, *arguments: int) -> list[RawRow]:
        return [run_in_process("bench of utm", _measure_service, name, *arguments)]

    kinds = (
        ("authority, in one process", "measure_durable", ()),
        ("authority, 1 client", "measure_authority", (1,)),
        ("authority, 32 clients", "measure_authority", (32,)),
        ("USS and DSS, 1 client", "measure_federation", (1,)),
    )
    return tuple(
        Case(f"{title}, {requests:,} requests", partial(ask, name, requests, *clients))
        for title, name, clients in kinds
    )


def _measure_service(name: str, *arguments: int) -> dict[str, Any]:
    from skyrange.bench import utm_services  # imports packages of the extra `utm`

    row: dict[str, Any] = getattr(utm_services, name)(*arguments)
    return row


def _routes(sizes: Sequence[tuple[float, int]], iterations: int = 0) -> tuple[Case, ...]:
    def plan(alt_m: float, routes: int) -> list[RawRow]:
        return [run_in_process("bench of planning", _plan_routes, routes, alt_m, iterations)]

    return tuple(Case(f"{routes} routes at {alt_m:g} m", partial(plan, alt_m, routes)) for alt_m, routes in sizes)


def _plan_routes(routes: int, alt_m: float, iterations: int) -> dict[str, Any]:
    return planning.measure(planning.load_city(None), routes, 1000.0, alt_m, 120.0, iterations)


def _cast(sizes: Sequence[tuple[int, int]]) -> tuple[Case, ...]:
    def cast(aircraft: int, scans: int) -> list[RawRow]:
        return [run_in_process("bench of rays", _cast_rays, aircraft, scans)]

    return tuple(Case(f"{count:,} aircraft, {scans} scans", partial(cast, count, scans)) for count, scans in sizes)


def _cast_rays(aircraft: int, scans: int) -> dict[str, Any]:
    return rays.measure(planning.load_city(None), "generated downtown", aircraft, scans)


def _require_ompl() -> None:
    from skyrange.planning.sampling import load_ompl

    load_ompl("bench planning-ompl")


def _require_engine(name: str) -> None:
    from skyrange.radio.external import ns3, omnetpp

    (ns3.find_program if name == "ns3" else omnetpp.find_command)()


def _attacked(count: int, seconds: float) -> tuple[Case, ...]:
    return (Case(_aircraft(count, seconds), lambda: attacks.measure(count, seconds)),)


def _transported(frames: int) -> tuple[Case, ...]:
    def send(transport: Any) -> list[RawRow]:
        return [transports.measure(transport, frames // 10 if transport == "http" else frames)]

    return tuple(Case(transport, partial(send, transport)) for transport in transports.TRANSPORTS)


def _ranges(sizes: Sequence[tuple[int, float]]) -> tuple[Case, ...]:
    def fly(count: int, seconds: float) -> list[RawRow]:
        return [run_in_process(f"bench live with {count} aircraft", live.measure, count, seconds)]

    return tuple(Case(_aircraft(*size), partial(fly, *size)) for size in sizes)


def _ardupilots(sizes: Sequence[tuple[int, float]], rates: str) -> tuple[Case, ...]:
    def fly(count: int, seconds: float) -> list[RawRow]:
        return [ardupilot.measure(count, seconds, rates=rates)]

    return tuple(Case(_aircraft(*size), partial(fly, *size)) for size in sizes)


def _require_ardupilot() -> None:
    from skyrange.vehicle.ardupilot.arducopter_binary import find_binary

    find_binary()


BENCHMARKS: Final = (
    Benchmark(
        "fleet-light",
        "Fleets in virtual time at light load, 8 telemetry frames an aircraft and second, as in bench fleet.",
        _FLEET,
        _fleets([(10, 20.0), (100, 20.0), (1000, 20.0)], fleet.LIGHT),
        _fleets([(100, 10.0)], fleet.LIGHT),
    ),
    Benchmark(
        "fleet-operator",
        "The same with the telemetry that QGroundControl requests, 103 frames an aircraft and second.",
        _FLEET,
        _fleets([(10, 10.0), (100, 10.0), (500, 10.0)], FleetOptions(load="operator")),
        _fleets([(30, 5.0)], FleetOptions(load="operator")),
    ),
    Benchmark(
        "fleet-remote-id",
        "The same at light load among buildings, with Remote ID over the radio medium, which all aircraft receive.",
        _FLEET,
        _fleets([(100, 10.0), (500, 10.0)], FleetOptions(remote_id=True)),
        _fleets([(50, 5.0)], FleetOptions(remote_id=True)),
    ),
    Benchmark(
        "cores",
        "One run of four operators on one core and on two, each pinned to a CPU of its own, as in bench cores.",
        _CORES,
        (*_on_cores([(500, 20.0)], remote_id=False), *_on_cores([(400, 10.0)], remote_id=True)),
        _on_cores([(100, 5.0)], remote_id=False),
        row_key="on",
        require=_require_cores,
    ),
    Benchmark(
        "attacks",
        "Fleets at light load with taps on all links between stations and aircraft, and with a flood of one link.",
        _ATTACKS,
        _attacked(100, 10.0),
        _attacked(20, 5.0),
        row_key="case",
    ),
    Benchmark(
        "radio",
        "The builtin radio medium with aircraft that broadcast once a second over a city of proportional size.",
        _RADIO,
        _radios([(100, 10.0), (1000, 10.0)], "builtin"),
        _radios([(100, 5.0)], "builtin"),
    ),
    Benchmark(
        "radio-ns3",
        "The same with ns-3 as the radio engine.",
        _RADIO,
        _radios([(100, 5.0)], "ns3"),
        _radios([(30, 2.0)], "ns3"),
        require=partial(_require_engine, "ns3"),
    ),
    Benchmark(
        "radio-omnetpp",
        "The same with OMNeT++ as the radio engine.",
        _RADIO,
        _radios([(100, 5.0)], "omnetpp"),
        _radios([(30, 2.0)], "omnetpp"),
        require=partial(_require_engine, "omnetpp"),
    ),
    Benchmark(
        "approval",
        "The approval authority in memory: requests decoded, decided on and answered while many flights are accepted.",
        _DECISIONS,
        _decisions([(100, 500), (1000, 500), (5000, 500)]),
        _decisions([(100, 200)]),
    ),
    Benchmark(
        "utm",
        "UTM services as processes, over HTTPS on loopback, each answer committed to a database first.",
        _ANSWERS,
        _services(300),
        _services(50)[:2],
        require=partial(require_extra, "utm", "bench utm"),
    ),
    Benchmark(
        "planning",
        "Routes of 1 km around the buildings of a generated downtown, on the lattice.",
        _ROUTES,
        _routes([(30.0, 50), (60.0, 50), (90.0, 50)]),
        _routes([(60.0, 20)]),
    ),
    Benchmark(
        "planning-ompl",
        "The same by BIT* of OMPL with 2,000 iterations.",
        _ROUTES,
        _routes([(60.0, 10)], 2000),
        _routes([(60.0, 3)], 2000),
        require=_require_ompl,
    ),
    Benchmark(
        "rays",
        "Rays and returns of ten rotating LiDARs, and a depth camera, over a generated downtown with other aircraft.",
        _RAYS,
        _cast([(100, 10), (1000, 10)]),
        _cast([(100, 3)]),
    ),
    Benchmark(
        "transports",
        "Transports of the live range between two processes on loopback.",
        _TRANSPORTS,
        _transported(20_000),
        _transported(2_000)[:2],
    ),
    Benchmark(
        "live",
        "A live range in real time: 30 s of pre-flight, then the measurement.",
        _LIVE,
        _ranges([(5, 10.0)]),
        (),
    ),
    Benchmark(
        "ardupilot",
        "ArduCopters in lockstep at a loop rate of 100 Hz (reduced).",
        _ARDUPILOT,
        _ardupilots([(1, 10.0), (5, 10.0)], "reduced"),
        _ardupilots([(1, 5.0)], "reduced"),
        require=_require_ardupilot,
    ),
)
"""All benchmarks, in the order in which they run."""
