"""Observations: features of the frames that a place has seen, one row for each aircraft.

A monitor at that place reads them, as a detector does: no true sender, no label and no true state is among them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.alerts import Alert
from skyrange.contracts.monitors import MonitorPlacement, ObservedFrames
from skyrange.core.geodesy import Origin
from skyrange.core.ids import link_name
from skyrange.core.time import NEVER, NS_PER_S, Time
from skyrange.detect.messages import ObservedMessages, read_messages
from skyrange.env.parts import STATION_SYSTEM

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Feature(NamedTuple):
    """A column of an observation; values are clipped to `low` and `high`."""

    name: str
    low: float
    high: float
    about: str


MAX_AGE_S: Final = 60.0
FEATURES: Final = (
    Feature("frames", 0, 10_000, "MAVLink frames from the aircraft in this step"),
    Feature("heartbeat_age_s", 0, MAX_AGE_S, "since the autopilot's last HEARTBEAT; 60 before the first"),
    Feature("position_age_s", 0, MAX_AGE_S, "since the last GLOBAL_POSITION_INT; 60 before the first"),
    Feature("armed", 0, 1, "1 if the last HEARTBEAT says that it is armed"),
    Feature("mode", -1, 255, "flight mode in the last HEARTBEAT, a number of ArduCopter; -1 before the first"),
    Feature("east_m", -100_000, 100_000, "position in the last GLOBAL_POSITION_INT, from the scenario's origin"),
    Feature("north_m", -100_000, 100_000, "likewise"),
    Feature("up_m", -1_000, 100_000, "its height above home"),
    Feature("vel_east_mps", -330, 330, "its velocity"),
    Feature("vel_north_mps", -330, 330, "likewise"),
    Feature("vel_up_mps", -330, 330, "likewise"),
    Feature("mission_item", -1, 65_535, "item in the last MISSION_CURRENT; -1 before the first"),
    Feature("foreign_acks", 0, 10_000, "COMMAND_ACKs in this step that answer another system than the station"),
    Feature("warnings", 0, 10_000, "STATUSTEXTs in this step of severity WARNING and worse"),
)
"""The columns of an observation, in order."""
_COLUMN: Final = {feature.name: place for place, feature in enumerate(FEATURES)}
_LOW: Final = np.array([feature.low for feature in FEATURES])
_HIGH: Final = np.array([feature.high for feature in FEATURES])
_AUTOPILOT: Final = int(mav.MAV_COMP_ID_AUTOPILOT1)


@dataclass(slots=True)
class TelemetryFeatures:
    """The monitor: it is served once a step, and then holds the observation of that step, of one or several runs."""

    vehicles: Sequence[str]
    """Aircraft in the order of the rows."""
    origin: Origin
    service_ns: Time
    received: bool
    """Whether telemetry arrives at its place, as at a ground station; else it is sent from there."""
    runs: int = 1
    """How many runs of a batch it listens in."""
    values: Floats = field(init=False)
    """(runs · aircraft, features)."""
    _heard_ns: dict[str, list[Time]] = field(init=False)
    _row_of_port: Ints | None = field(default=None, init=False)
    """By number of the port."""

    def __post_init__(self) -> None:
        self.values = np.zeros((self.runs * len(self.vehicles), len(FEATURES)))
        for name in ("mode", "mission_item"):
            self.values[:, _COLUMN[name]] = -1.0
        self._heard_ns = {"heartbeat_age_s": [-NEVER] * len(self.values)}
        self._heard_ns["position_age_s"] = list(self._heard_ns["heartbeat_age_s"])
        self._set_ages(0)

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """Compute the observation of the step that ends at `now`; raises no alerts."""
        observed = frames.take(frames.received == self.received)
        if self._row_of_port is None:
            rows = {link_name("gcs", vehicle): row for row, vehicle in enumerate(self.vehicles)}
            numbers = [port.run * len(rows) + rows[port.link] for port in frames.ports]
            self._row_of_port = np.array(numbers, dtype=np.int64)
        aircraft = self._row_of_port[observed.places]
        self._set("frames", np.bincount(aircraft, minlength=len(self.values)))
        self._read_heartbeats(observed, aircraft)
        self._read_positions(observed, aircraft)
        current = read_messages(observed, "MISSION_CURRENT")
        for row, place in _last(current, aircraft).items():
            self.values[row, _COLUMN["mission_item"]] = current.values["seq"][place]
        acks = read_messages(observed, "COMMAND_ACK")
        targets = acks.values["target_system"]
        self._count("foreign_acks", acks, aircraft, (targets != STATION_SYSTEM) & (targets != 0))
        texts = read_messages(observed, "STATUSTEXT")
        self._count("warnings", texts, aircraft, texts.values["severity"] <= mav.MAV_SEVERITY_WARNING)
        self._set_ages(now)
        return ()

    def read(self, run: int = 0) -> NDArray[np.float32]:
        """The observation of a run, (aircraft, features): a copy."""
        count = len(self.vehicles)
        return np.clip(self.values[run * count : (run + 1) * count], _LOW, _HIGH).astype(np.float32)

    def _read_heartbeats(self, frames: ObservedFrames, aircraft: NDArray[np.int64]) -> None:
        heartbeats = read_messages(frames, "HEARTBEAT")
        for row, place in _last(heartbeats, aircraft).items():
            self._heard_ns["heartbeat_age_s"][row] = int(frames.at_ns[heartbeats.rows[place]])
            armed = int(heartbeats.values["base_mode"][place]) & mav.MAV_MODE_FLAG_SAFETY_ARMED
            self.values[row, _COLUMN["armed"]] = bool(armed)
            self.values[row, _COLUMN["mode"]] = heartbeats.values["custom_mode"][place]

    def _read_positions(self, frames: ObservedFrames, aircraft: NDArray[np.int64]) -> None:
        positions = read_messages(frames, "GLOBAL_POSITION_INT")
        for row, place in _last(positions, aircraft).items():
            self._heard_ns["position_age_s"][row] = int(frames.at_ns[positions.rows[place]])
            message = {
                name: int(positions.values[name][place]) for name in ("lat", "lon", "relative_alt", "vx", "vy", "vz")
            }
            east_m, north_m = self.origin.enu_of(message["lat"] * 1e-7, message["lon"] * 1e-7)
            start = _COLUMN["east_m"]
            self.values[row, start : start + 6] = (
                east_m, north_m, message["relative_alt"] / 1e3,
                message["vy"] / 100, message["vx"] / 100, -message["vz"] / 100,
            )  # fmt: skip

    def _count(
        self, name: str, messages: ObservedMessages, aircraft: NDArray[np.int64], which: NDArray[np.bool_]
    ) -> None:
        self._set(name, np.bincount(aircraft[messages.rows[which]], minlength=len(self.values)))

    def _set(self, name: str, values: NDArray[np.int64]) -> None:
        self.values[:, _COLUMN[name]] = values

    def _set_ages(self, now: Time) -> None:
        for name, heard in self._heard_ns.items():
            ages = [min((now - at) / NS_PER_S, MAX_AGE_S) for at in heard]
            self.values[:, _COLUMN[name]] = ages


def _last(messages: ObservedMessages, aircraft: NDArray[np.int64]) -> dict[int, int]:
    """By row of an observation, the place of its autopilot's last message."""
    from_autopilot = np.flatnonzero(messages.components == _AUTOPILOT)
    return dict(zip(aircraft[messages.rows[from_autopilot]].tolist(), from_autopilot.tolist(), strict=True))


@dataclass(frozen=True, slots=True)
class _Given:
    """Hands out the monitor whose observations the environment reads."""

    monitor: TelemetryFeatures

    def __call__(self) -> TelemetryFeatures:
        return self.monitor


def place_monitor(agent: str, monitor: TelemetryFeatures) -> MonitorPlacement:
    """A monitor of an agent at the ground station's end of its aircraft's control links, or at the companion's."""
    links = [link_name("gcs", vehicle) for vehicle in monitor.vehicles]
    return MonitorPlacement(agent, _Given(monitor), links, "gcs" if monitor.received else "companion")


def describe(observation: NDArray[np.float32]) -> list[Mapping[str, float]]:
    """An observation (aircraft, features) by the names of its features: a mapping for each aircraft."""
    names = [feature.name for feature in FEATURES]
    return [dict(zip(names, row, strict=True)) for row in observation.tolist()]
