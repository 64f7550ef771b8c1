"""Hand-made telemetry of three aircraft for tests of detectors, and what a detector finds in it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import sin
from typing import Any

from skyrange.codec.mavlink import Packer, dialect
from skyrange.contracts.alerts import Alert
from skyrange.contracts.monitors import DetectorContext, DetectorPlugin, Monitor, MonitorPlacement, ObservedFrame
from skyrange.core.chance import Chance
from skyrange.core.geodesy import Origin
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_S, Epoch, from_seconds
from skyrange.record import RunRecord, replay_monitor
from skyrange.testing.checks.monitors import serve

ORIGIN = Origin(40.7780, -73.9550, 20.0, -32.7)
EPOCH = Epoch(1_767_268_800 * NS_PER_S)
PORTS = (
    Port("blue.gcs", "approval:blue"),
    Port("blue.gcs", "gcs:blue/b1"),
    Port("blue.gcs", "gcs:blue/b2"),
    Port("blue.gcs", "gcs:blue/b3"),
)
SPEED = 5.0
Say = Callable[[float], tuple[float, float, float]]
"""Time → position east, north and up that is reported."""


def make(plugin: DetectorPlugin, **params: Any) -> Monitor:
    context = DetectorContext("one", ["blue/b1", "blue/b2", "blue/b3"], ORIGIN, EPOCH, Chance(1))
    return plugin.make(plugin.params.model_validate(params), context)


def alerts(plugin: DetectorPlugin, frames: Sequence[ObservedFrame], until_s: float, **params: Any) -> list[Alert]:
    ordered = sorted(frames, key=lambda frame: (frame.at, frame.port))
    found = serve(make(plugin, **params), PORTS, ordered, from_seconds(until_s))
    return [alert for *_, said in found for alert in said]


def residuals(found: Sequence[Alert]) -> set[tuple[str, object]]:
    return {(alert.subject, alert.data["residual"]) for alert in found}


def seen(at_s: float, message: Any, place: int = 1, component: int = 1) -> ObservedFrame:
    payload = Packer(place, component).pack(message)
    return ObservedFrame(PORTS[place], True, from_seconds(at_s + 0.05), payload, "blue/b.companion", "blue.gcs")


def times(until_s: float, rate_hz: float) -> list[float]:
    return [number / rate_hz for number in range(int(until_s * rate_hz))]


def north(at_s: float, place: int = 1) -> tuple[float, float, float]:
    """Northwards at `SPEED`, 50 m beside each other, 30 m high; a centimetre of noise that depends on the place."""
    noise = 0.02 * sin(40.0 * at_s + place)
    return 50.0 * place + noise, SPEED * at_s, 30.0


def position(
    at_s: float, say: Say, place: int = 1, velocity: tuple[float, float, float] | None = None, heading_deg: float = 0.0
) -> ObservedFrame:
    """GLOBAL_POSITION_INT; the velocity is the path's own unless it is given (east, north, up)."""
    east, nrth, up = say(at_s)
    if velocity is None:
        before, after = say(at_s - 0.05), say(at_s + 0.05)
        velocity = ((after[0] - before[0]) * 10, (after[1] - before[1]) * 10, (after[2] - before[2]) * 10)
    lat, lon = ORIGIN.geodetic_of(east, nrth)
    v_e, v_n, v_u = (round(speed * 100) for speed in velocity)
    return seen(
        at_s,
        dialect.MAVLink_global_position_int_message(
            round(at_s * 1e3), round(lat * 1e7), round(lon * 1e7), round((20 + up) * 1e3), round(up * 1e3),
            v_n, v_e, -v_u, round(heading_deg * 100) % 36_000,
        ),
        place,
    )  # fmt: skip


def attitude(at_s: float, roll: float = 0.0, pitch: float = -0.1, yaw: float = 0.0, place: int = 1) -> ObservedFrame:
    return seen(at_s, dialect.MAVLink_attitude_message(round(at_s * 1e3), roll, pitch, yaw, 0.0, 0.0, 0.0), place)


def fix(at_s: float, say: Say, shift_m: float = 0.0, fix_type: int = 3, h_acc_mm: int = 1500) -> ObservedFrame:
    east, nrth, up = say(at_s)
    lat, lon = ORIGIN.geodetic_of(east + shift_m, nrth)
    message = dialect.MAVLink_gps_raw_int_message(
        round(at_s * 1e6), fix_type, round(lat * 1e7), round(lon * 1e7), round((20 + up) * 1e3), 100, 100, 500, 0, 10,
        0, h_acc_mm, 2500, 200, 0,
    )  # fmt: skip
    return seen(at_s, message)


def pressure(at_s: float, up_m: float) -> ObservedFrame:
    hpa = 1013.25 * (1.0 - 2.25577e-5 * (20.0 + up_m)) ** 5.25588
    return seen(at_s, dialect.MAVLink_scaled_pressure_message(round(at_s * 1e3), hpa, 0.0, 1500))


def replayed(record: RunRecord, plugin: DetectorPlugin, links: Sequence[str] = ("gcs:*",)) -> list[Alert]:
    placement = MonitorPlacement("one", lambda: make(plugin), links, "gcs")
    return [found.alert for found in replay_monitor(record, placement)]
