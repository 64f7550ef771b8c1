"""Benchmark of route planning: routes of one length between random places of a city."""

from __future__ import annotations

import math
import time
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from skyrange.bench.yardstick import yardstick_us
from skyrange.city.city import City
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.ids import hash64
from skyrange.planning.limits import Limits, NoRouteError
from skyrange.planning.routes import find_route
from skyrange.planning.sampling import Sampling

_STREAM: Final = "bench.planning"
_MOST_TRIES: Final = 50


def load_city(buildings: Path | None) -> City:
    """The city of a file of buildings, or a generated downtown of 12 by 12 blocks."""
    from skyrange.assembly.city import build_city
    from skyrange.scenario.shipped import load

    scenario = load("squares" if buildings else "corridor-rush", buildings=buildings)
    city = build_city(scenario)
    if city is None:
        raise InputError.one("bench planning", "--buildings", str(buildings), "a file with buildings")
    return city


def measure(
    city: City, routes: int, length_m: float, alt_m: float, ceiling_m: float, iterations: int = 0
) -> dict[str, Any]:
    """Plan `routes` routes of `length_m` whose ends are free, on the lattice, or by BIT* with `iterations` of it.

    `p50_ms` and `p95_ms` are wall time of one route, `cpu_ms` is its mean processor time; `detour` is the mean of flown
    over straight length, `late` that of its duration over the straight flight's; `no_way` counts pairs of free places
    without a way.
    """
    chance, limits = Chance(1), Limits(alt_m, ceiling_m)
    west, south, east, north = city.bounds
    sampling = Sampling(iterations, 1) if iterations else None
    times: list[float] = []
    lates: list[float] = []
    detours: list[float] = []
    tried = no_way = 0
    cpu_s = 0.0
    find_route(city, [(east + 400.0, north + 400.0), (east + 410.0, north + 400.0)], limits)  # compiled before
    while len(times) < routes and tried < _MOST_TRIES * routes:
        across, up, turn, _ = chance.uniform4(_STREAM, hash64("place"), tried, 0)
        tried += 1
        start = west + across * (east - west), south + up * (north - south)
        angle = 2.0 * math.pi * turn
        end = start[0] + length_m * math.cos(angle), start[1] + length_m * math.sin(angle)
        if not city.is_clear([(*start, alt_m)], 8.0) or not city.is_clear([(*end, alt_m)], 8.0):
            continue
        began, before_s = time.perf_counter(), time.process_time()
        try:
            route = np.array(find_route(city, [start, end], limits, sampling))
        except NoRouteError:
            no_way += 1
            continue
        times.append(time.perf_counter() - began)
        cpu_s += time.process_time() - before_s
        detours.append(float(np.linalg.norm(np.diff(route[:, :2], axis=0), axis=1).sum()) / length_m)
        flown_s = sum(limits.costs.of(a, b) for a, b in pairwise(route.tolist()))
        lates.append(flown_s / limits.costs.of((*start, alt_m), (*end, alt_m)))
    milliseconds = np.array(times) * 1e3
    return {
        "buildings": len(city),
        "routes": len(times),
        "length_m": length_m,
        "alt_m": alt_m,
        "no_way": no_way,
        "cpu_ms": round(cpu_s / len(times) * 1e3, 2) if times else None,
        "p50_ms": round(float(np.percentile(milliseconds, 50)), 1) if times else None,
        "p95_ms": round(float(np.percentile(milliseconds, 95)), 1) if times else None,
        "detour": round(float(np.mean(detours)), 3) if times else None,
        "late": round(float(np.mean(lates)), 3) if times else None,
        "yardstick_us": round(yardstick_us(), 2),
    }
