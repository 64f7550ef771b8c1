"""One hovering aircraft whose estimate is set by hand, for tests of failsafes; all else is flown."""

from __future__ import annotations

from functools import cache
from typing import Any

from skyrange.codec.mavlink import Packer, dialect
from skyrange.vehicle.builtin.fleet import Fleet
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import Range

V = "blue/b1"
ALT_M = 10.0


@cache
def _base() -> Range:
    r = Range([VehicleSpec(V, 1)])
    r.take_off(V, ALT_M)
    return r


def hovering(**params: float) -> Range:
    """A continuation of a flight in GUIDED, hovering 10 m above home, with some parameters changed now."""
    r = _base().copy()
    for name, value in params.items():
        put(r, name, value)
    return r


def standing(**params: float) -> Range:
    """One aircraft on the ground, disarmed in STABILIZE at boot."""
    return Range([VehicleSpec(V, 1, params=params)])


def put(r: Range, name: str, value: float) -> None:
    """Change a parameter."""
    r.send(V, dialect.MAVLink_param_set_message(1, 1, name.encode(), value, dialect.MAV_PARAM_TYPE_REAL32))
    r.run(0.01)


class _Believing(Fleet):
    """A fleet whose estimate is what a test says, whatever the estimator writes at every tick."""

    held: dict[str, Any]

    @property
    def estimate(self) -> Any:
        records = self.__dict__["estimated"]
        for name, value in self.held.items():
            records[name] = value
        return records


def believe(r: Range, **fields: Any) -> None:
    """Set what the estimator says, from now on."""
    fleet = r.engines[0]._fleet
    if not isinstance(fleet, _Believing):
        fleet.__dict__["estimated"] = fleet.__dict__.pop("estimate")
        fleet.__class__ = _Believing
        fleet.__dict__["held"] = {}
    fleet.__dict__["held"].update(fields)


def beat(r: Range, system: int = 255) -> None:
    """A ground station's heartbeat, now."""
    message = dialect.MAVLink_heartbeat_message(dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
    r.send_bytes(V, Packer(system, 190).pack(message))
    r.run(0.01)


def texts(r: Range, since_s: float = 0.0) -> list[tuple[int, str]]:
    """(severity, text) of every STATUSTEXT from a moment on."""
    found = []
    for said in r.said:
        if said.message.get_type() == "STATUSTEXT" and said.at_s >= since_s:
            raw = said.message.text
            found.append((said.message.severity, raw.decode() if isinstance(raw, bytes) else raw))
    return found


def when(r: Range, words: str) -> float:
    """When a text was first sent, s."""
    for said in r.said:
        if said.message.get_type() == "STATUSTEXT" and words in str(said.message.text):
            return said.at_s
    raise AssertionError(f"nobody said {words!r}; said: {r.words()}")


def modes(r: Range, since_s: float = 0.0) -> list[tuple[str, str]]:
    """(mode, reason) of every change of mode from a moment on."""
    return [
        (str(note.data["mode"]), str(note.data["reason"]))
        for at, note in r.notes
        if note.kind == "event.mode" and at >= since_s
    ]
