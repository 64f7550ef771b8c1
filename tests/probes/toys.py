"""Small agents, taps, engines and a world: just enough traffic to try the contracts on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import (
    BodyInputs,
    EngineBase,
    Finished,
    Floats,
    InstanceStatus,
    Poses,
    Sensors,
    Source,
    World,
)
from skyrange.contracts.frames import Fate, Frame, FrameBlock
from skyrange.contracts.links import Channel, LinkSpec, Route
from skyrange.contracts.mailboxes import Inbox, Note, Outbox
from skyrange.contracts.verdicts import Label
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_MS, Time

MS = NS_PER_MS


class Log:
    """An observer that keeps everything as plain tuples."""

    def __init__(self) -> None:
        self.frames: list[tuple[Any, ...]] = []
        self.notes: list[tuple[Any, ...]] = []
        self.labels: list[Label] = []
        self.alerts: list[tuple[Time, str, Alert]] = []
        self.truth: list[tuple[Any, ...]] = []
        self.truth_period_ns: Time = 10 * MS

    def on_frame(self, frame: Frame) -> None:
        self.frames.append(
            (
                frame.sent_ns,
                frame.link,
                frame.direction,
                frame.sender,
                frame.serial,
                frame.src,
                frame.dst,
                frame.arrived_ns if frame.fate is Fate.DELIVERED else -1,
                str(frame.fate),
                frame.payload,
                str(frame.parent),
                frame.causes,
            )
        )

    def on_block(self, block: FrameBlock) -> None:
        for frame in block.frames():
            self.on_frame(frame)

    def on_note(self, now: Time, source: str, note: Note) -> None:
        self.notes.append((now, source, note.kind, note.about, tuple(sorted(note.data.items())), note.causes))

    def on_label(self, label: Label) -> None:
        self.labels.append(label)

    def on_alert(self, now: Time, detector: str, alert: Alert) -> None:
        self.alerts.append((now, detector, alert))

    def on_truth(self, now: Time, world: World) -> None:
        self.truth.append((now, {name: column.tobytes() for name, column in world.truth().items()}))

    def table(self) -> list[tuple[Any, ...]]:
        """The frames in canonical order: neither fusing nor sharding may show in it."""
        return sorted(self.frames, key=lambda row: row[:5])

    def on(self, *links: str) -> list[tuple[Any, ...]]:
        """The frames of some links only."""
        return [row for row in self.table() if row[1] in links]


@dataclass
class Fleet:
    """Autopilots of many vehicles: each sends a counter every `period` and answers what it is asked."""

    name: str
    vehicles: Sequence[str]
    period: Time = 50 * MS
    service_ns: Time = 10 * MS
    sent: dict[str, int] = field(default_factory=dict)
    due: Time = 0

    def __post_init__(self) -> None:
        self.ports: Sequence[Port] = [Port(f"{v}.autopilot", f"autopilot:{v}") for v in self.vehicles]

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = Outbox()
        for arrival in inbox:
            out.send(arrival.port, b"ack " + arrival.payload, (arrival.ref,))
            out.note("decision.answer", arrival.port.endpoint, {"size": len(arrival.payload)}, (arrival.ref,))
        if now >= self.due:
            for vehicle, port in zip(self.vehicles, self.ports, strict=True):
                n = self.sent.get(vehicle, 0)
                self.sent[vehicle] = n + 1
                out.send(port, f"{vehicle} telemetry {n}".encode())
            self.due = now + self.period
        return out

    def next_wakeup(self) -> Time | None:
        return self.due


@dataclass
class Station:
    """A ground station: asks each of its aircraft something every `period`, counts what comes back."""

    operator: str
    vehicles: Sequence[str]
    period: Time = 70 * MS
    service_ns: Time = 20 * MS
    asked: int = 0
    heard: list[tuple[Time, bytes]] = field(default_factory=list)
    due: Time = 0

    def __post_init__(self) -> None:
        self.name = f"{self.operator}.gcs"
        self.ports: Sequence[Port] = [Port(self.name, f"gcs:{v}") for v in self.vehicles]

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = Outbox()
        for arrival in inbox:
            self.heard.append((arrival.at, arrival.payload))
        if now >= self.due:
            for port in self.ports:
                out.send(port, f"ask {self.asked}".encode())
            self.asked += 1
            self.due = now + self.period
        return out

    def next_wakeup(self) -> Time | None:
        return self.due


def onboard(vehicle: str, gcs: Channel | None = None) -> tuple[list[LinkSpec], list[Route]]:
    """The three hops between an autopilot and its ground station, with the published names."""
    operator = vehicle.split("/")[0]
    ap, proxy, companion = (f"{vehicle}.{role}" for role in ("autopilot", "proxy", "companion"))
    wire = Channel(mode="reliable", latency_ns=100_000)
    links = [
        LinkSpec(f"gcs:{vehicle}", f"{operator}.gcs", companion, gcs or Channel(latency_ns=20 * MS)),
        LinkSpec(f"log:{vehicle}", companion, proxy, wire),
        LinkSpec(f"autopilot:{vehicle}", proxy, ap, wire),
    ]
    routes = [
        Route(proxy, f"autopilot:{vehicle}", f"log:{vehicle}", MS),
        Route(companion, f"log:{vehicle}", f"gcs:{vehicle}", 10 * MS),
        Route(companion, f"gcs:{vehicle}", f"log:{vehicle}", 10 * MS),
        Route(proxy, f"log:{vehicle}", f"autopilot:{vehicle}", MS),
    ]
    return links, routes


ROUGH = Channel(
    latency_ns=20 * MS, jitter_ns=15 * MS, loss=0.1, duplicate=0.05, reorder=0.05, rate_bps=50_000, queue_bytes=25
)
"""A channel on which everything that can happen to a frame does."""


class WorldBase:
    """Members of a world that nothing imposes poses on or disturbs, and that no one asks for its motion."""

    def set_source(self, rows: NDArray[np.int64], source: Source) -> None:
        raise NotImplementedError

    def impose(self, rows: slice | NDArray[np.int64], poses: Poses) -> None:
        raise NotImplementedError

    def body_inputs(self, rows: slice | NDArray[np.int64]) -> BodyInputs:
        raise NotImplementedError

    def disturb(self, rows: NDArray[np.int64], thrust_share: Floats, wind_enu_mps: Floats) -> None:
        raise NotImplementedError

    def motion(self) -> tuple[Floats, Floats]:
        raise NotImplementedError


class Bodies(WorldBase):
    """A world of points that integrate their one actuator."""

    def __init__(self, vehicles: Sequence[str], quantum_ns: Time = 2_500_000) -> None:
        self.vehicles: Sequence[str] = list(vehicles)
        self.quantum_ns = quantum_ns
        self._command = np.zeros((len(self.vehicles), 1))
        self._height_m = np.zeros(len(self.vehicles))
        self._at: Time | None = None

    def advance(self, now: Time) -> Sequence[Note]:
        if self._at is not None:
            self._height_m += self._command[:, 0] * (now - self._at) / 1e9
        self._at = now
        return ()

    def sensors(self, rows: slice | NDArray[np.int64]) -> Sensors:
        height = self._height_m[rows]
        n = len(height)
        return Sensors(
            gyro_radps=np.zeros((n, 3)),
            accel_mps2=np.zeros((n, 3)),
            attitude=np.zeros((n, 4)),
            gnss_enu_m=np.zeros((n, 3)),
            gnss_vel_enu_mps=np.zeros((n, 3)),
            baro_up_m=height.copy(),
            rangefinder_m=height.copy(),
            compass_gauss=np.zeros((n, 3)),
            gnss_accuracy=np.zeros((n, 3)),
            gnss_fix=np.zeros(n, dtype=np.int64),
            gnss_satellites=np.zeros(n, dtype=np.int64),
            gnss_time_ns=np.zeros(n, dtype=np.int64),
            gnss_utc_error_ns=np.zeros(n, dtype=np.int64),
            battery_v=height.copy(),
            battery_a=height.copy(),
            rotor_radps=np.zeros((n, 4)),
            delta_angle_rad=np.zeros((n, 3)),
            delta_velocity_mps=np.zeros((n, 3)),
        )

    def actuate(self, rows: slice | NDArray[np.int64], actuators: NDArray[np.float64]) -> None:
        self._command[rows] = actuators

    @property
    def sources(self) -> Sequence[Source]:
        return (Source.DYNAMIC,) * len(self.vehicles)

    @property
    def present(self) -> None:
        return None

    def truth(self) -> Mapping[str, NDArray[np.float64]]:
        return {"up_m": self._height_m.copy()}


class Climber(EngineBase):
    """A lockstep engine: each instance climbs at its own rate; `falls_silent` may say when one stops answering."""

    clock: Literal["lockstep", "wall"] = "lockstep"
    repeatable: Literal["bytes", "outcome"] = "bytes"
    moves: Sequence[str] = ()

    def __init__(
        self,
        name: str,
        vehicles: Sequence[str],
        *,
        falls_silent: tuple[str, Time] | None = None,
        preroll_ns: Time = 0,
        boots_at: Time = 0,
    ) -> None:
        self.name = name
        self.vehicles: Sequence[str] = list(vehicles)
        self.ports: Sequence[Port] = [Port(f"{v}.autopilot", f"autopilot:{v}") for v in vehicles]
        self.service_ns = 10 * MS
        self.preroll_ns = preroll_ns
        self.begun: list[Time] = []
        self._silent = falls_silent
        self._boots_at = boots_at
        self._mail = 0

    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        assert tick % self.service_ns == 0 or not inbox
        assert all(arrival.at <= tick for arrival in inbox)
        self.begun.append(tick)
        self._mail += len(inbox)

    def finish(self, tick: Time, wall_deadline_s: float) -> Finished:
        status = [
            InstanceStatus.SILENT
            if self._silent is not None and v == self._silent[0] and tick >= self._silent[1]
            else InstanceStatus.BOOTING
            if tick < self._boots_at
            else InstanceStatus.READY
            for v in self.vehicles
        ]
        rates = np.array(
            [[0.0 if s is not InstanceStatus.READY else 1.0 + i] for i, s in enumerate(status)], dtype=np.float64
        )
        out = Outbox()
        if tick % (100 * MS) == 0:
            for port, state in zip(self.ports, status, strict=True):
                if state is InstanceStatus.READY:
                    out.send(port, f"mail {self._mail}".encode())
        return Finished(rates, out, status)
