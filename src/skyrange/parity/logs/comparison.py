"""Comparison of logs with simulated flights of the same missions: what is flown, and what the flights say together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.core.errors import InputError
from skyrange.core.files import expand_user
from skyrange.core.typed_json import check_type
from skyrange.flightlog.model import FlightLog
from skyrange.flightlog.run_folder import FORMAT as RUN
from skyrange.parity.flights import KINDS
from skyrange.parity.logs.bands import Band, TrackScore, fit_band, score_track
from skyrange.parity.logs.choice import UnjudgedFlight, choose_flights
from skyrange.parity.logs.measures import QUANTITIES, FlightMeasures, measure_flight, restore_measures
from skyrange.parity.logs.plan import FlownFlight, LogParityPlan, ToldPlan, name_run, tell_flight
from skyrange.runtime.run import free_folder
from skyrange.statistics.clusters import draw_weights, percentile_limits
from skyrange.study.execution.executors import Executor
from skyrange.study.execution.plan_run import OnPlanProgress, forget_failures, require_success, run_plan
from skyrange.study.execution.store import MANIFEST as PLAN
from skyrange.study.execution.store import RunStore, claim_store
from skyrange.study.plan_size import MAX_RUNS, check_size

Floats = NDArray[np.float64]
CONFIDENCE: Final = 0.95
_REPLICATES: Final = 2000
LEAST_SEEDS: Final = 2
"""A band needs as many."""


@dataclass(frozen=True)
class ComparedFlight:
    """One flight of a log and the simulated ones of one autopilot."""

    name: str
    autopilot: str
    log: FlightMeasures
    flown: Sequence[FlightMeasures]
    """Those that left the ground, by seed."""
    outcomes: Mapping[str, int]
    """How many simulated flights ended how."""
    judged_from_s: float

    def is_judged(self, quantity: str) -> bool:
        """Whether the log has a quantity, and none of it is of the part from which something was estimated."""
        found = self.log.quantities.get(quantity)
        return found is not None and found.begin_s >= self.judged_from_s

    def values(self, quantity: str) -> Floats:
        """The values of a quantity in the simulated flights that have it."""
        return np.array([each.quantities[quantity].value for each in self.flown if quantity in each.quantities])

    def difference(self, quantity: str) -> float | None:
        """The median of the simulated flights less the log, relative to the log if the quantity says so."""
        values = self.values(quantity)
        if not self.is_judged(quantity) or not len(values):
            return None
        logged = self.log.quantities[quantity].value
        off = float(np.median(values)) - logged
        return off / logged if QUANTITIES[quantity].relative else off

    @cached_property
    def times_s(self) -> Floats:
        """The times of the log's positions that are judged, in s since the flight left the ground."""
        times: Floats = self.log.track[:, 0]
        return times[times + self.log.lifted_s >= self.judged_from_s]

    @cached_property
    def band(self) -> Band | None:
        """The band of the simulated tracks at those times; `None` with fewer than two of them."""
        if len(self.flown) < LEAST_SEEDS or not len(self.times_s):
            return None
        return fit_band(np.stack([_place_at(each.track, self.times_s) for each in self.flown]))

    @cached_property
    def score(self) -> TrackScore | None:
        """How the band holds the log's track."""
        return None if self.band is None else score_track(self.band, _place_at(self.log.track, self.times_s))


def _place_at(track: Floats, times_s: Floats) -> Floats:
    """(n, 3) metres at times, from a track (m, 4); before and after it, its ends."""
    return np.stack([np.interp(times_s, track[:, 0], track[:, axis]) for axis in (1, 2, 3)], axis=1)


@dataclass(frozen=True, slots=True)
class Median:
    """The median over flights of a difference, with limits by the percentiles of a bootstrap over the flights."""

    value: float
    low: float
    high: float
    flights: int


def find_median(values: Sequence[float]) -> Median | None:
    """The median of values with its limits; `None` for none."""
    if not values:
        return None
    known = np.array(values)
    weights = draw_weights(len(known), _REPLICATES, 1)
    medians = np.array([np.median(np.repeat(known, row.astype(np.int64))) for row in weights])
    point = float(np.median(known))
    low, high = percentile_limits(medians, point, CONFIDENCE)
    return Median(point, low, high, len(known))


@dataclass(frozen=True)
class LogParity:
    """What came of all flights."""

    path: Path
    plan: LogParityPlan
    flights: Sequence[ComparedFlight]
    """By flight and autopilot."""

    def of(self, autopilot: str) -> list[ComparedFlight]:
        """The flights with an autopilot."""
        return [flight for flight in self.flights if flight.autopilot == autopilot]

    def median(self, autopilot: str, quantity: str) -> Median | None:
        """The median difference of a quantity over the flights."""
        differences = (flight.difference(quantity) for flight in self.of(autopilot))
        return find_median([value for value in differences if value is not None])

    def scores(self, autopilot: str) -> list[TrackScore]:
        """How the bands hold the tracks of the log."""
        return [flight.score for flight in self.of(autopilot) if flight.score is not None]

    def describe(self) -> dict[str, Any]:
        """As plain data."""
        return {
            "path": str(self.path),
            "seeds": dict(self.plan.seeds),
            "unjudged": dict(self.plan.unjudged),
            "autopilots": {
                autopilot: {
                    "differences": {
                        name: asdict(median)
                        for name in QUANTITIES
                        if (median := self.median(autopilot, name)) is not None
                    },
                    "flights": [_describe_flight(flight) for flight in self.of(autopilot)],
                }
                for autopilot in self.plan.seeds
            },
        }


def _describe_flight(flight: ComparedFlight) -> dict[str, Any]:
    quantities = {}
    for name in QUANTITIES:
        logged = flight.log.quantities.get(name)
        values = flight.values(name)
        quantities[name] = {
            "log": None if logged is None else logged.value,
            "simulated": float(np.median(values)) if len(values) else None,
            "difference": flight.difference(name),
            "judged": flight.is_judged(name),
        }
    return {
        "flight": flight.name,
        "outcomes": dict(flight.outcomes),
        "quantities": quantities,
        "track": None if flight.score is None else asdict(flight.score),
    }


def plan_logs(logs: Sequence[FlightLog], seeds: Mapping[str, int], without: Sequence[str] = ()) -> LogParityPlan:
    """The plan of a comparison with so many seeds by autopilot.

    Raises `InputError` as `choose_flights` does, for flights without a track, and for unknown autopilots.
    """
    for autopilot, number in seeds.items():
        if autopilot not in KINDS:
            raise InputError.one("parity log", "--autopilot", autopilot, f"one of {', '.join(KINDS)}")
        if number < LEAST_SEEDS:
            raise InputError.one("parity log", "--seeds", number, f"{LEAST_SEEDS} or more: a band needs them")
    judged, others = choose_flights(logs, without)
    told = []
    for each in judged:
        measures = measure_flight(each.flight)
        if measures is None:
            others.append(UnjudgedFlight(each.name, "its positions do not tell when it left the ground"))
        else:
            told.append(tell_flight(each, measures))
    if not told:
        raise InputError.one("parity log", "flights", "none that can be measured", "a flight that leaves the ground")
    sizes = {"flights": len(told), "seeds of all autopilots": sum(seeds.values())}
    check_size("parity log", sizes, MAX_RUNS, "Ask for fewer --seeds, or name fewer logs.")
    unnamed = {RUN: "a simulated aircraft"}
    firmware = ", ".join(dict.fromkeys(log.firmware or unnamed.get(log.format, "an unknown firmware") for log in logs))
    return LogParityPlan(tuple(told), dict(seeds), {other.name: other.reason for other in others}, firmware)


def compare_logs(
    plan: LogParityPlan,
    out: Path | None,
    executor: Executor,
    on_progress: OnPlanProgress | None = None,
    finished: Set[str] = frozenset(),
) -> LogParity:
    """Fly a plan, or what is left of it in a folder in which it was begun, and compare.

    `finished` names the runs of the folder that need no check. Raises `InputError` before anything is flown for
    scenarios that cannot be built and for a folder of something else, `ComponentError` if a run failed, and
    `ShortfallError` after Ctrl-C.
    """
    plan.check(finished)
    store = claim_store(plan, expand_user(out) if out is not None else free_folder("log-parity"))
    forget_failures(store)
    plan.write_missions(store.path)
    require_success(plan, run_plan(plan, store, executor, on_progress))
    return read_comparison(plan, store)


def resume_log_parity(store: RunStore, executor: Executor, on_progress: OnPlanProgress | None = None) -> LogParity:
    """Go on with the comparison in a folder: `skyrange resume`."""
    told: ToldPlan = check_type(store.told, ToldPlan, str(store.path), f"{PLAN}: told")
    plan = LogParityPlan(tuple(told["flights"]), told["seeds"], told["unjudged"], told["firmware"])
    finished = store.finished() - {result.name for result in store.list_failures()}
    return compare_logs(plan, store.path, executor, on_progress, finished)


def read_comparison(plan: LogParityPlan, store: RunStore) -> LogParity:
    """The comparison of flights that are stored. Raises `InputError` for damaged ones."""
    return LogParity(store.path, plan, list(_read_flights(plan, store)))


def _read_flights(plan: LogParityPlan, store: RunStore) -> Iterator[ComparedFlight]:
    for told in plan.flights:
        for autopilot, seeds in plan.seeds.items():
            flown: list[FlightMeasures] = []
            outcomes: dict[str, int] = {}
            for seed in range(1, seeds + 1):
                _, data = store.read(name_run(told["name"], autopilot, seed), FlownFlight)
                outcomes[data["outcome"]] = outcomes.get(data["outcome"], 0) + 1
                if data["measures"] is not None:
                    flown.append(restore_measures(data["measures"]))
            log = restore_measures(told["log"])
            yield ComparedFlight(told["name"], autopilot, log, flown, outcomes, told["judged_from_s"])
