"""Benchmark of the live range: missions on real sockets in real time, everything recorded."""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.bench.fleet import WARM_UP_S, fleet_scenario, flying
from skyrange.bench.yardstick import yardstick_us
from skyrange.core.time import to_seconds
from skyrange.record import RunRecord, load
from skyrange.runtime.live.deployment import Group
from skyrange.runtime.live.range import LiveRange, OnUpdate, prepare_range
from skyrange.runtime.live.supervisor.supervisor import run_range

MS_NS = 1e6


def measure(
    vehicles: int,
    seconds: float,
    group: Group | None = None,
    port_offset: int = 0,
    on_update: OnUpdate | None = None,
) -> dict[str, Any]:
    """One row: fly `vehicles` builtin aircraft for `WARM_UP_S` and `seconds` more, all in wall seconds.

    `held` is whether no process was ever more than half a second behind (else they are in `fell_behind`), `max_lag_s`
    the largest delay of any. `cores` is the processor time of all processes of the range, in cores, `aircraft_per_core`
    follows from it; `elsewhere_cores` is what everything else on the machine used meanwhile (`None` if the system does
    not report it): on a quiet machine it is near 0. `frames_per_s` is over all hops, `crossings_per_s` over sockets,
    `flying` as in `bench fleet`. `added_ms`, by kind of link, is the time of a hop beyond its channel's own latency,
    from the record, median and 99th percentile: it includes waiting for the sender's turn, its socket, and the
    receiver's turn. `start_s` and `end_s` are wall seconds before time 0 and after the end. Raises as
    `supervisor.run_range`.
    """
    scenario = fleet_scenario(vehicles, seconds)
    with tempfile.TemporaryDirectory() as folder:
        began, busy = time.monotonic(), busy_s()
        live_range = prepare_range(scenario, Path(folder) / "run", group=group, port_offset=port_offset)
        used = sum(os.times()[:4])
        run_range(live_range, on_update)
        ended = time.monotonic()
        used = sum(os.times()[:4]) - used  # also of children that have ended, which all nodes are
        elsewhere = None if busy is None else max((busy_s() or busy) - busy - used, 0.0) / (ended - began)
        record = load(live_range.folder)
        return {
            **_row(live_range, record, vehicles, seconds),
            "elsewhere_cores": None if elsewhere is None else round(elsewhere, 2),
            "start_s": round(live_range.zero_ns / 1e9 - began, 2),
            "end_s": round(ended - live_range.zero_ns / 1e9 - scenario.duration_s, 2),
            "yardstick_us": round(yardstick_us(), 2),
        }


def _row(live_range: LiveRange, record: RunRecord, vehicles: int, seconds: float) -> dict[str, Any]:
    took_s = WARM_UP_S + seconds
    cores = sum(float(member.status.get("cpu_s", 0.0)) for member in live_range.members.values()) / took_s
    late_s = {name: to_seconds(int(member.status.get("late_ns", 0))) for name, member in live_range.members.items()}
    behind = record.manifest["live"]["fell_behind"]
    return {
        "vehicles": vehicles,
        "seconds": seconds,
        "processes": len(live_range.members),
        "held": not behind,
        "fell_behind": behind,
        "max_lag_s": round(max(late_s.values()), 3),
        "cores": round(cores, 3),
        "cores_by_process": _busiest(live_range, took_s),
        "aircraft_per_core": round(vehicles / cores, 1) if cores else None,
        "flying": flying(record),
        "frames_per_s": round(record.rows("frames") / took_s, 1),
        "crossings_per_s": round(record.manifest["crossings"]["matched"] / took_s, 1),
        "lost": record.manifest["crossings"]["lost"],
        "added_ms": added_ms(record, live_range),
    }


def _busiest(live_range: LiveRange, took_s: float) -> dict[str, float]:
    """The five processes that use most processor time, in cores."""
    shares = {name: float(member.status.get("cpu_s", 0.0)) / took_s for name, member in live_range.members.items()}
    return {name: round(shares[name], 3) for name in sorted(shares, key=lambda name: -shares[name])[:5]}


def added_ms(record: RunRecord, live_range: LiveRange) -> dict[str, dict[str, float]]:
    """By kind of link, the time of frames between processes beyond their channel's latency."""
    crossing = {crossed.link.name for crossed in live_range.crossings}
    links = live_range.built.wiring.links
    latency_ns = {spec.name: spec.channel.latency_ns for spec in links if spec.name in crossing}
    delays: dict[str, list[NDArray[np.float64]]] = {}
    for batch in record.batches("frames", ["link", "sent_ns", "arrived_ns"]):
        rows = pa.Table.from_batches([batch])
        rows = rows.filter(pc.and_(pc.is_valid(rows.column("arrived_ns")), pc.greater_equal(rows.column("sent_ns"), 0)))
        took_ns = pc.subtract(rows.column("arrived_ns"), rows.column("sent_ns"))
        names = rows.column("link").combine_chunks().dictionary_encode()
        codes = names.indices.to_numpy(zero_copy_only=False)
        for code, link in enumerate(names.dictionary.to_pylist()):
            if link in latency_ns:
                delay = took_ns.to_numpy()[codes == code] - latency_ns[link]
                delays.setdefault(link.partition(":")[0], []).append(delay)
    added = {kind: np.concatenate(parts) / MS_NS for kind, parts in sorted(delays.items())}
    return {
        kind: {
            "frames": len(values),
            "median": round(float(np.median(values)), 3),
            "p99": round(float(np.percentile(values, 99)), 3),
        }
        for kind, values in added.items()
        if len(values)
    }


def busy_s() -> float | None:
    """Processor seconds for which this machine has been busy, all cores together (Linux)."""
    try:
        first = Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()[1:]
    except OSError:
        return None
    user, nice, system, _idle, _waiting, *others = map(int, first[:8])
    return (user + nice + system + sum(others)) / os.sysconf("SC_CLK_TCK")
