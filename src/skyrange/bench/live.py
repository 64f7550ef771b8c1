"""How many aircraft does a live range fly in real time? Missions on real sockets, everything recorded, nobody waits."""

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
from skyrange.runtime.live.plan import Group
from skyrange.runtime.live.range import OnLook, Range, prepare
from skyrange.runtime.live.supervisor import fly

MS_NS = 1e6


def measure(
    vehicles: int,
    seconds: float,
    group: Group | None = None,
    port_offset: int = 0,
    on_look: OnLook | None = None,
) -> dict[str, Any]:
    """One row: fly `vehicles` builtin aircraft for `WARM_UP_S` and `seconds` more, wall seconds all of them.

    `held`: whether no process was ever more than half a second behind (else they are in `fell_behind`); `max_lag_s` the
    most that any was. `cores` what all processes of the range took of the processor, in cores, `aircraft_per_core` from
    that; `elsewhere_cores` what everything else on the machine took meanwhile (`None` where the system does not say):
    what is far from 0 is no quiet machine. `frames_per_s` over all hops, `crossings_per_s` those over sockets, `flying`
    as in `bench fleet`. `added_ms` by kind of link: what a hop took beyond its channel's own latency, from the record,
    median and 99th percentile: waiting for the sender's turn, its socket, and the receiver's. `start_s` and `end_s` are
    wall seconds before time 0 and after the end. Raises as `supervisor.fly`.
    """
    scenario = fleet_scenario(vehicles, seconds)
    with tempfile.TemporaryDirectory() as folder:
        began, busy = time.monotonic(), busy_s()
        flown = prepare(scenario, Path(folder) / "run", group=group, port_offset=port_offset)
        used = sum(os.times()[:4])
        fly(flown, on_look)
        ended = time.monotonic()
        used = sum(os.times()[:4]) - used  # of children that have ended too: of all nodes
        elsewhere = None if busy is None else max((busy_s() or busy) - busy - used, 0.0) / (ended - began)
        record = load(flown.folder)
        return {
            **_row(flown, record, vehicles, seconds),
            "elsewhere_cores": None if elsewhere is None else round(elsewhere, 2),
            "start_s": round(flown.zero_ns / 1e9 - began, 2),
            "end_s": round(ended - flown.zero_ns / 1e9 - scenario.duration_s, 2),
            "yardstick_us": round(yardstick_us(), 2),
        }


def _row(flown: Range, record: RunRecord, vehicles: int, seconds: float) -> dict[str, Any]:
    took_s = WARM_UP_S + seconds
    cores = sum(float(one.status.get("cpu_s", 0.0)) for one in flown.members.values()) / took_s
    late_s = {name: to_seconds(int(one.status.get("late_ns", 0))) for name, one in flown.members.items()}
    behind = record.manifest["live"]["fell_behind"]
    return {
        "vehicles": vehicles,
        "seconds": seconds,
        "processes": len(flown.members),
        "held": not behind,
        "fell_behind": behind,
        "max_lag_s": round(max(late_s.values()), 3),
        "cores": round(cores, 3),
        "cores_by_process": _busiest(flown, took_s),
        "aircraft_per_core": round(vehicles / cores, 1) if cores else None,
        "flying": flying(record),
        "frames_per_s": round(record.rows("frames") / took_s, 1),
        "crossings_per_s": round(record.manifest["crossings"]["matched"] / took_s, 1),
        "lost": record.manifest["crossings"]["lost"],
        "added_ms": added_ms(record, flown),
    }


def _busiest(flown: Range, took_s: float) -> dict[str, float]:
    """The five processes that take most, in cores."""
    shares = {name: float(one.status.get("cpu_s", 0.0)) / took_s for name, one in flown.members.items()}
    return {name: round(shares[name], 3) for name in sorted(shares, key=lambda name: -shares[name])[:5]}


def added_ms(record: RunRecord, flown: Range) -> dict[str, dict[str, float]]:
    """By kind of link, of the frames that crossed between processes: what each took beyond its channel's latency."""
    latency_ns = {one.link.name: one.link.channel.latency_ns for one in flown.crossings}
    found: dict[str, list[NDArray[np.float64]]] = {}
    for batch in record.batches("frames", ["link", "sent_ns", "arrived_ns"]):
        rows = pa.Table.from_batches([batch])
        rows = rows.filter(pc.and_(pc.is_valid(rows.column("arrived_ns")), pc.greater_equal(rows.column("sent_ns"), 0)))
        took_ns = pc.subtract(rows.column("arrived_ns"), rows.column("sent_ns"))
        links = rows.column("link").combine_chunks().dictionary_encode()
        codes = links.indices.to_numpy(zero_copy_only=False)
        for code, link in enumerate(links.dictionary.to_pylist()):
            if link in latency_ns:
                own = took_ns.to_numpy()[codes == code] - latency_ns[link]
                found.setdefault(link.partition(":")[0], []).append(own)
    added = {kind: np.concatenate(parts) / MS_NS for kind, parts in sorted(found.items())}
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
    """Processor seconds that this machine has been busy, all cores together (Linux)."""
    try:
        first = Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()[1:]
    except OSError:
        return None
    user, nice, system, _idle, _waiting, *others = map(int, first[:8])
    return (user + nice + system + sum(others)) / os.sysconf("SC_CLK_TCK")
