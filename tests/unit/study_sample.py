"""A run that was never flown, for the tests of what draws runs: squares above a few buildings, with every table."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from skyrange.core.geodesy import Origin
from skyrange.record.read.run import RunRecord
from skyrange.record.read.tables import Tables

HOMES = {"blue/b1": (5, 5), "blue/b2": (10, 0), "green/g1": (-5, -10), "green/g2": (-15, 0), "green/g3": (0, -20)}
SIDES = {"blue/b1": 5, "blue/b2": 7, "green/g1": 4, "green/g2": 3, "green/g3": 2}
ORIGIN = {"lat_deg": -35.3633280, "lon_deg": 149.1652241, "alt_msl_m": 584.0, "geoid_m": 19.0}
S = 1_000_000_000
ENDS = {
    "gcs": ("gcs", "companion"),
    "log": ("companion", "proxy"),
    "autopilot": ("proxy", "autopilot"),
    "rid_data": ("proxy", "companion"),
}

SCHEMAS = {
    "truth": {
        "time_ns": pa.int64(), "vehicle": pa.string(), "source": pa.string(), "east_m": pa.float64(),
        "north_m": pa.float64(), "up_m": pa.float64(), "vel_east_mps": pa.float64(), "vel_north_mps": pa.float64(),
        "vel_up_mps": pa.float64(), "qw": pa.float64(), "qx": pa.float64(), "qy": pa.float64(), "qz": pa.float64(),
    },
    "telemetry": {
        "time_ns": pa.int64(), "operator": pa.string(), "vehicle": pa.string(), "system_id": pa.int64(),
        "component_id": pa.int64(), "message": pa.string(), "lat": pa.float64(), "lon": pa.float64(),
        "alt": pa.float64(), "vx": pa.float64(), "vy": pa.float64(), "vz": pa.float64(),
    },
    "frames": {
        "link": pa.string(), "direction": pa.string(), "sender": pa.string(), "serial": pa.int64(), "src": pa.string(),
        "dst": pa.string(), "sent_ns": pa.int64(), "arrived_ns": pa.int64(), "fate": pa.string(),
        "payload_id": pa.int64(), "size": pa.int32(), "parent": pa.string(), "causes": pa.list_(pa.string()),
    },
    "payloads": {"payload_id": pa.int64(), "payload": pa.binary()},
    "decisions": {
        "time_ns": pa.int64(), "kind": pa.string(), "about": pa.string(), "source": pa.string(), "data": pa.string(),
        "causes": pa.list_(pa.string()),
    },
    "labels": {
        "at_ns": pa.int64(), "attack": pa.string(), "actor": pa.string(), "action": pa.string(), "frame": pa.string(),
        "child": pa.string(), "until_ns": pa.int64(), "benign": pa.bool_(), "fault": pa.bool_(),
        "harmless_intrusion": pa.bool_(),
    },
}  # fmt: skip
SCHEMAS["receptions"] = {
    "time_ns": pa.int64(), "link": pa.string(), "receiver": pa.string(), "rssi_dbm": pa.float32(),
    "outcome": pa.string(), "east_m": pa.float32(), "north_m": pa.float32(), "up_m": pa.float32(),
}  # fmt: skip
SCHEMAS["events"] = SCHEMAS["decisions"]
SCHEMAS["alerts"] = {
    "time_ns": pa.int64(), "detector": pa.string(), "kind": pa.string(), "subject": pa.string(), "score": pa.float64(),
    "data": pa.string(),
}  # fmt: skip
SCHEMAS["observations"] = {
    "time_ns": pa.int64(), "receiver": pa.string(), "radio": pa.string(), "rssi_dbm": pa.float32(),
    "frame": pa.string(), "uas_id": pa.string(), "east_m": pa.float64(), "north_m": pa.float64(),
    "up_m": pa.float64(), "height_m": pa.float64(),
}  # fmt: skip
SCHEMAS["sensors"] = {"time_ns": pa.int64(), "vehicle": pa.string()}


class NoPayloads(Tables):
    """Tables without a payload."""

    def frames_with_payloads(
        self, columns: Sequence[str] | None = None, *, encoded: bool = False
    ) -> Iterator[pa.Table]:
        return iter(())


class SampleRun(RunRecord):
    """A record of which nothing is on disk."""

    _rows: dict[str, list[dict[str, Any]]]
    _tables: dict[str, pa.Table]

    def __init__(self, path: Path, manifest: dict[str, Any], city: list[dict[str, Any]], rows: dict[str, Any]) -> None:
        complete = {"record": {"level": "full"}, "status": "unknown", **manifest}
        super().__init__(path, complete, NoPayloads(path, spooled=False))
        self.__dict__.update(_city=city, _rows=rows, _tables={})

    def move(self, path: Path) -> None:
        self.__dict__["path"] = path

    @property
    def city(self) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = self.__dict__["_city"]
        return found

    def table(self, name: str, columns: Sequence[str] | None = None) -> pa.Table:
        if name not in self._tables:
            schema = pa.schema(list(SCHEMAS[name].items()))
            self._tables[name] = pa.Table.from_pylist(self._rows.get(name, []), schema=schema)
        table = self._tables[name]
        return table if columns is None else table.select(list(columns))

    def telemetry(self, message: str, columns: Sequence[str] | None = None) -> pa.Table:
        rows = self.table("telemetry")
        rows = rows.filter(pc.equal(rows.column("message"), message)).drop_columns(["message"])
        for name in set(columns or ()) - set(rows.column_names):  # every table has all fields of its message
            rows = rows.append_column(name, pa.nulls(rows.num_rows, pa.float64()))
        return rows if columns is None else rows.select(list(columns))

    def batches(self, name: str, columns: Sequence[str] | None = None) -> Iterator[pa.RecordBatch]:
        yield from self.table(name, columns).to_batches(max_chunksize=1000)


def square(home: tuple[float, float], side_m: float, alt_m: float, seconds: np.ndarray) -> np.ndarray:
    """(n, 3) metres: 5 s on the ground, up at 1 m/s, round the square at 1.5 m/s, down at 0.8 m/s."""
    climb, lap = alt_m / 1.0, 4 * side_m / 1.5
    out = np.zeros((len(seconds), 3))
    for row, second in enumerate(seconds):
        t = second - 5.0
        up = min(max(t, 0.0), alt_m) if t < climb + lap else max(0.0, alt_m - 0.8 * (t - climb - lap))
        along = min(max(t - climb, 0.0), lap) * 1.5
        leg, rest = divmod(along, side_m)
        corner = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]
        a, b = corner[int(leg) % 4], corner[int(leg) % 4 + 1]
        f = rest / side_m
        east, north = (a[0] + (b[0] - a[0]) * f) * side_m, (a[1] + (b[1] - a[1]) * f) * side_m
        out[row] = (home[0] + east, home[1] + north, up)
    return out


def squares(path: Path, status: str = "complete", seconds: float = 60.0, hostile: bool = False) -> SampleRun:
    """The five-aircraft demonstration between six buildings."""
    fleet = {name: (HOMES[name], float(SIDES[name]), 5.0) for name in HOMES}
    return fly(path, fleet, {"blue": "blue", "green": "green"}, small_city(), status, seconds, hostile)


def small_city() -> list[dict[str, Any]]:
    """Six blocks around the homes, one of them with a courtyard."""
    blocks = [
        (-32, 8, 12, 9, 14),
        (-30, -28, 10, 14, 22),
        (18, 14, 12, 12, 31),
        (22, -22, 9, 16, 18),
        (-4, 16, 10, 8, 9),
    ]
    city = [{"height_m": h, "rings": [[[e, n], [e + w, n], [e + w, n + d], [e, n + d]]]} for e, n, w, d, h in blocks]
    court = [[[-14, -38], [8, -38], [8, -27], [-14, -27]], [[-8, -35], [-8, -30], [2, -30], [2, -35]]]
    return [*city, {"height_m": 12, "rings": court}]


def fly(
    path: Path,
    fleet: Mapping[str, tuple[tuple[float, float], float, float]],
    colours: dict[str, str],
    city: list[dict[str, Any]],
    status: str = "complete",
    seconds: float = 60.0,
    hostile: bool = False,
    rate_hz: float = 10.0,
) -> SampleRun:
    """A run of aircraft given as `{id: (home, side_m, alt_m)}`."""
    rng = np.random.default_rng(4)
    origin = Origin(ORIGIN["lat_deg"], ORIGIN["lon_deg"], ORIGIN["alt_msl_m"])
    times = np.arange(0.0, seconds, 1 / rate_hz)
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in SCHEMAS}
    links, outcomes = [], {}
    for name, (home, side, alt) in fleet.items():
        operator = name.split("/")[0]
        path_m = square(home, side, alt, times)
        path_m[:, :2] += (
            0.06 * np.stack([np.sin(times * 1.3 + side), np.cos(times * 0.9)], axis=1) * (path_m[:, 2:] > 0)
        )
        velocity = np.gradient(path_m, times, axis=0)
        for t, p, v in zip(times, path_m, velocity, strict=True):
            rows["truth"].append(
                {"time_ns": round(t * S), "vehicle": name, "source": "dynamic", "east_m": p[0], "north_m": p[1],
                 "up_m": p[2], "vel_east_mps": v[0], "vel_north_mps": v[1], "vel_up_mps": v[2], "qw": 1.0, "qx": 0.0,
                 "qy": 0.0, "qz": 0.0}
            )  # fmt: skip
        noise = np.cumsum(rng.normal(0, 0.04, (len(times), 3)), axis=0) * 0.3
        stride = max(1, int(rate_hz / 4))
        for k in range(0, len(times), stride):
            p, v = path_m[k] + noise[k], velocity[k]
            lat, lon = origin.geodetic_of(p[0], p[1])
            rows["telemetry"].append(
                {"time_ns": round((times[k] + 0.045) * S), "operator": operator, "vehicle": name, "system_id": 1,
                 "component_id": 1, "message": "GLOBAL_POSITION_INT", "lat": round(lat * 1e7), "lon": round(lon * 1e7),
                 "alt": (p[2] + ORIGIN["alt_msl_m"]) * 1e3, "vx": v[1] * 100, "vy": v[0] * 100, "vz": -v[2] * 100}
            )  # fmt: skip
            rows["telemetry"].append(
                {"time_ns": round((times[k] + 0.045) * S), "operator": operator, "vehicle": name, "system_id": 1,
                 "component_id": 1, "message": "VFR_HUD", "alt": 12.5}
            )  # fmt: skip
        for kind in ("gcs", "log", "autopilot", "rid_data"):
            a, b = ENDS[kind]
            links.append({"name": f"{kind}:{name}", "a": f"{operator if a == 'gcs' else name}.{a}", "b": f"{name}.{b}"})
            for k in range(0, len(times), 4):
                sent = round(times[k] * S)
                lost = kind == "gcs" and rng.random() < 0.02
                delay = round((0.03 + 0.02 * rng.random() if kind == "gcs" else 0.001) * S)
                rows["frames"].append(
                    {"link": f"{kind}:{name}", "direction": "rev", "sender": f"{name}.companion", "serial": k,
                     "src": name, "dst": operator, "sent_ns": sent, "arrived_ns": None if lost else sent + delay,
                     "fate": "lost" if lost else "delivered", "payload_id": k, "size": 40 + k % 7, "causes": []}
                )  # fmt: skip
        climb, lap = alt, 4 * side / 1.5
        events: list[tuple[float, str, dict[str, Any]]] = [
            (0.8, "event.mode", {"mode": "GUIDED", "reason": "gcs"}),
            (3.5, "event.armed", {}),
            (4.6, "event.mode", {"mode": "AUTO", "reason": "gcs"}),
            (5.0, "event.takeoff", {"alt_m": alt}),
            *((5 + climb + lap * leg / 4, "event.item_reached", {"seq": leg + 1}) for leg in range(1, 5)),
            (5 + climb + lap, "event.mode", {"mode": "LAND", "reason": "mission"}),
            (5 + climb + lap + alt / 0.8, "event.landed", {}),
            (7 + climb + lap + alt / 0.8, "event.disarmed", {}),
        ]
        for t, kind, data in events:
            if t < seconds:
                rows["events"].append(_note(t, kind, name, f"{name}.autopilot", data))
        rows["decisions"].append(_note(0.2, "decision.approval_asked", name, f"{operator}.gcs", {"volumes": 4}))
        rows["decisions"].append(_note(0.4, "decision.upload", name, f"{operator}.gcs", {"items": 6}))
        rows["decisions"].append(
            _note(3.2, "decision.arm", name, f"{operator}.gcs", {}, [f"gcs:{name}|rev|{name}.companion|3"])
        )
        done = 7 + climb + lap + alt / 0.8
        if status == "complete":
            outcomes[name] = {"state": "complete", "reason": "mission flown, landed, disarmed", "finished_s": done}
            rows["events"].append(
                _note(min(done + 0.3, seconds), "event.outcome", name, f"{operator}.gcs", {"state": "complete"})
            )
    if hostile:
        victim = next(iter(fleet))
        for k in range(12):
            rows["labels"].append(
                {"at_ns": round((14 + k * 0.4) * S), "attack": "ghost", "actor": "ghost.tap",
                 "action": "delay" if k % 3 else "inject", "frame": f"gcs:{victim}|fwd|ghost.tap|{k}"}
            )  # fmt: skip
    frames = len(rows["frames"])
    manifest = {
        "format": 1, "name": "squares", "seed": 7, "status": status, "skyrange": "0.1.0",
        "versions": {"python": "3.11.9", "numpy": "2.1.0", "numba": "0.60"},
        "platform": {"machine": "x86_64", "system": "Linux"},
        "start_utc": "2026-01-01T12:00:00Z", "duration_s": seconds, "simulated_s": seconds, "origin": ORIGIN,
        "operators": [{"id": name, "color": colour, "approval": "approve-all"} for name, colour in colours.items()],
        "vehicles": [
            {"id": name, "operator": name.split("/")[0], "color": "", "autopilot": "builtin", "airframe": "iris",
             "system_id": k + 1, "home_enu_m": [home[0], home[1], 0],
             "plan": "square"}
            for k, (name, (home, side, alt)) in enumerate(fleet.items())
        ],
        "links": links, "city": {"source": "grid", "buildings": len(city)},
        "digests": {"fingerprint": "9f2c51d0a7e44b6c", "events": "aa", "frames": "bb", "truth": "cc"}
        if status == "complete" else {},
        "counts": {"frames": frames, "delivered": sum(r["fate"] == "delivered" for r in rows["frames"])},
        "timings": {"wall_s": 1.9}, "outcomes": outcomes,
    }  # fmt: skip
    return SampleRun(path, manifest, city, rows)


def fleet_of(count: int, operators: int, pitch_m: float = 40.0) -> dict[str, tuple[tuple[float, float], float, float]]:
    """`count` aircraft on a square grid, dealt to operators in turn."""
    side = math.ceil(math.sqrt(count))
    return {
        f"op{k % operators}/v{k}": (
            ((k % side - side / 2) * pitch_m, (k // side - side / 2) * pitch_m),
            10.0 + k % 15,
            20.0 + k % 30,
        )
        for k in range(count)
    }


def _note(
    t: float, kind: str, about: str, source: str, data: dict[str, Any], causes: list[str] | None = None
) -> dict[str, Any]:
    return {
        "time_ns": round(t * S),
        "kind": kind,
        "about": about,
        "source": source,
        "data": json.dumps(data),
        "causes": causes or [],
    }
