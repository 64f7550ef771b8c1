"""Frames, notes, labels and a world for the tests of the record: small, of real MAVLink bytes, and repeatable."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from skyrange.codec.mavlink import Packer, dialect
from skyrange.contracts.components import Floats, Observer, Sensors, Source
from skyrange.contracts.frames import Fate, Frame, end_journey
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.verdicts import Label
from skyrange.core.ids import FrameId
from skyrange.core.time import Time
from tests.probes.toys import WorldBase

MS = 1_000_000
VEHICLES = ("blue/b1", "blue/b2", "green/g1")
HEADER: dict[str, Any] = {
    "name": "sample",
    "seed": 1,
    "start_utc": "2026-01-01T12:00:00Z",
    "duration_s": 10.0,
    "operators": [{"id": "blue", "color": "#00f"}, {"id": "green", "color": "#0f0"}, {"id": "idle", "color": ""}],
    "vehicles": [{"id": vehicle, "operator": vehicle.split("/")[0]} for vehicle in VEHICLES],
}


class StillWorld(WorldBase):
    """Truth that is a function of the number of ticks and the row alone."""

    quantum_ns = 5 * MS // 2
    present = None

    def __init__(self, vehicles: Sequence[str] = VEHICLES) -> None:
        self.vehicles = vehicles
        self.sources = (Source.DYNAMIC,) * len(vehicles)
        self.ticks = 0

    def advance(self, now: Time) -> Sequence[Note]:
        return ()

    def actuate(self, rows: object, actuators: Floats) -> None:
        """Nothing moves."""

    def truth(self) -> Mapping[str, Floats]:
        self.ticks += 1
        rows = np.arange(len(self.vehicles), dtype=np.float64)
        return {"east_m": rows * 0.1 + self.ticks, "north_m": rows / 3.0, "up_m": rows * 0.0, "throttle": rows}

    def sensors(self, rows: object) -> Sensors:
        n = len(self.vehicles)
        ones = np.ones(n)
        return Sensors(
            np.full((n, 3), 0.1), np.full((n, 3), 9.8), np.full((n, 4), 0.5), np.full((n, 3), 7.0), np.zeros((n, 3)),
            ones * 2.5, ones * 1.5, np.full((n, 3), 0.25), np.full((n, 3), 1.5), np.full(n, 3), np.full(n, 10),
            np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64), ones * 12.6, ones * 8.0, np.zeros((n, 4)),
            np.full((n, 3), 0.001), np.full((n, 3), 0.098),
        )  # fmt: skip


def make_frame(
    link: str,
    direction: str,
    sender: str,
    serial: int,
    sent_ns: int,
    payload: bytes,
    *,
    arrived_ns: int | None = None,
    fate: Fate = Fate.DELIVERED,
    src: str | None = None,
    dst: str = "there",
    parent: FrameId | None = None,
    causes: tuple[FrameId, ...] = (),
) -> Frame:
    """A frame that met its fate."""
    frame = Frame(
        link,
        direction,
        sender,
        serial,
        src or sender,
        dst,
        sent_ns=sent_ns,
        payload=payload,
        parent=parent,
        causes=causes,
    )
    end_journey(frame, fate, sent_ns + MS if arrived_ns is None else arrived_ns)
    return frame


def traffic(rounds: int, vehicles: Sequence[str] = VEHICLES) -> Iterator[Frame]:
    """`rounds` heartbeats and attitudes of each vehicle over three hops, every fifth lost; one command back each."""
    packers = {vehicle: Packer(number + 1, 1) for number, vehicle in enumerate(vehicles)}
    stations = {vehicle: Packer(255, 190) for vehicle in vehicles}
    for count in range(rounds):
        for vehicle in vehicles:
            at = count * 100 * MS
            if count % 2:
                message = dialect.MAVLink_attitude_message(count, 0.1 * count, -0.25, 1.0, 0.0, 0.0, 0.0)
            else:
                message = dialect.MAVLink_heartbeat_message(2, 3, 81, count, 4, 3)
            payload = packers[vehicle].pack(message)
            parent = None
            lost = count % 5 == 4
            for hop, role in (("autopilot", "autopilot"), ("log", "proxy"), ("gcs", "companion")):
                sender = f"{vehicle}.{role}"
                fate = Fate.LOST if lost and hop == "gcs" else Fate.DELIVERED
                frame = make_frame(f"{hop}:{vehicle}", "rev", sender, count, at, payload, fate=fate, parent=parent)
                parent = frame.id
                at += 2 * MS
                yield frame
            operator = vehicle.split("/")[0]
            command = dialect.MAVLink_statustext_message(6, f'say "{count}", please'.encode())
            yield make_frame(
                f"gcs:{vehicle}", "fwd", f"{operator}.gcs", count, at, stations[vehicle].pack(command),
                causes=(parent,) if parent and count % 2 else (),
            )  # fmt: skip


NOTES = [
    (0, "gcs.blue", Note("decision.plan", "blue/b1", {"items": 3, "ratio": float("nan")})),
    (5 * MS, "builtin", Note("event.armed", "blue/b1", {})),
    (
        9 * MS,
        "builtin",
        Note("event.mode", "blue/b1", {"mode": "AUTO", "reason": None}, (FrameId("l", "fwd", "s", 4),)),
    ),
    (400 * MS, "gcs.blue", Note("event.outcome", "blue/b1", {"state": "complete", "reason": ""})),
    (500 * MS, "gcs.green", Note("event.outcome", "green/g1", {"state": "failed", "reason": "no answer"})),
]
LABELS = [
    Label(3 * MS, "late", "late.tap", "delay", FrameId("gcs:blue/b1", "fwd", "blue.gcs", 0), None, 9 * MS),
    Label(4 * MS, "swap", "swap.tap", "replace", FrameId("l", "fwd", "s", 1), FrameId("l", "fwd", "swap.tap", 0)),
]


def tell(observer: Observer, rounds: int = 20, vehicles: Sequence[str] = VEHICLES) -> None:
    """Have the observer see the sample run: traffic, notes, labels and a truth tick per 100 ms."""
    world: Any = StillWorld(vehicles)
    for frame in traffic(rounds, vehicles):
        observer.on_frame(frame)
    for now, source, note in NOTES:
        observer.on_note(now, source, note)
    for label in LABELS:
        observer.on_label(label)
    for tick in range(rounds):
        observer.on_truth(tick * 100 * MS, world)
