"""How is a companion flown in a kernel without a radio? Everybody hears everybody, and a liar may be among them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from skyrange.city.city import City
from skyrange.codec.f3411 import BasicId, IdType, Location, MessagePack, Status, UaType, encode
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import RidHeader, Transport
from skyrange.contracts.frames import Payloads
from skyrange.contracts.links import Channel, LinkSpec
from skyrange.contracts.mailboxes import Inbox, Note, Outbox
from skyrange.core.chance import Chance
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.gcs.flight.lifecycle import Flight
from skyrange.gcs.plan import plans
from skyrange.gcs.plan.plans import FlightPlan
from skyrange.gcs.station import GroundStation
from skyrange.kernel import EngineMount, Kernel, Wiring
from skyrange.record.write.memory_observer import MemoryObserver
from skyrange.remoteid.broadcast_profiles import Broadcast, sender_address, serial_number
from skyrange.utm.approval_service import FlightApproval
from skyrange.utm.approve_all import ApproveAll
from skyrange.vehicle.avoidance.contract import Avoidance
from skyrange.vehicle.builtin.engine import BuiltinFleet
from skyrange.vehicle.companion import Companion, CompanionSpec
from skyrange.vehicle.contract import VehicleSpec
from skyrange.vehicle.onboard_network import onboard_links, onboard_routes, oracle_links
from skyrange.world import Body, SensorSpec, World
from skyrange.world.sensing.geomagnetism import magnetic_field_at
from tests.unit.fake_autopilot import EPOCH, ORIGIN

CRUISE_MPS = 8.0


@dataclass
class Ghost:
    """A forged aircraft that stands somewhere from one time to another, told once a second."""

    name: str
    enu_m: tuple[float, float, float]
    start_s: float = 0.0
    stop_s: float = 1e9

    def message(self, now: Time) -> bytes:
        lat, lon = ORIGIN.geodetic_of(self.enu_m[0], self.enu_m[1])
        altitude = ORIGIN.alt_msl_m + ORIGIN.geoid_m + self.enu_m[2]
        who = BasicId(IdType.SERIAL_NUMBER, UaType.HELICOPTER_OR_MULTIROTOR, serial_number(self.name))
        body = encode(MessagePack((who, Location(Status.AIRBORNE, lat, lon, altitude, speed_mps=0.0))))
        header = RidHeader(Transport.WIFI_BEACON, 6, 0, sender_address(self.name), -6000, now)
        return link_payload.pack(header, body)


@dataclass
class Everybody:
    """Stands in for the oracle: what one sends, all others hear 5 ms later, at -60 dBm."""

    vehicles: Sequence[str]
    ghosts: Sequence[Ghost] = ()
    name: str = "oracle"
    service_ns: Time = 5 * NS_PER_MS
    heard: list[tuple[Time, str, bytes]] = field(default_factory=list)
    due: Time = NS_PER_S

    def __post_init__(self) -> None:
        self.ports: Sequence[Port] = [
            Port("oracle", f"{kind}:{v}") for v in self.vehicles for kind in ("rid_up", "rid_down")
        ]

    def next_wakeup(self) -> Time | None:
        return self.due if self.ghosts else None

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = Outbox()
        for arrival in inbox:
            sender = arrival.port.link.split(":", 1)[1]
            self.heard.append((now, sender, arrival.payload))
            frame = link_payload.unpack(arrival.payload)
            payload = link_payload.pack(frame.header._replace(rssi_cdbm=-6000, channel=6, time_ns=now), frame.body)
            rows = [row for row, v in enumerate(self.vehicles) if v != sender]
            if rows:
                places = np.array(rows, dtype=np.int64) * 2 + 1
                out.send_block(places, Payloads.of([payload] * len(rows)))
        if self.ghosts and now >= self.due:
            self.due = now + NS_PER_S
            for ghost in self.ghosts:
                if ghost.start_s * NS_PER_S <= now < ghost.stop_s * NS_PER_S:
                    for v in self.vehicles:
                        out.send(Port("oracle", f"rid_down:{v}"), ghost.message(now))
        return out


@dataclass
class Spoken:
    at_s: float
    source: str
    note: Note


class Notes(MemoryObserver):
    """Keeps notes with their times, and true positions every 0.1 s."""

    truth_period_ns = 100 * NS_PER_MS

    def __init__(self) -> None:
        super().__init__()
        self.spoken: list[Spoken] = []
        self.track: list[tuple[float, np.ndarray]] = []

    def on_note(self, now: Time, source: str, note: Note) -> None:
        super().on_note(now, source, note)
        self.spoken.append(Spoken(now / NS_PER_S, source, note))

    def on_truth(self, now: Time, world: Any) -> None:
        truth = world.truth()
        self.track.append((now / NS_PER_S, np.stack([truth["east_m"], truth["north_m"], truth["up_m"]], axis=1)))

    def kinds_of(self, about: str, *wanted: str) -> list[tuple[float, str]]:
        return [(s.at_s, s.note.kind) for s in self.spoken if s.note.about == about and s.note.kind in wanted]


@dataclass
class Flown:
    """A range that is wired, and what was seen of it."""

    kernel: Kernel
    notes: Notes
    companion: Companion
    oracle: Everybody
    station: GroundStation
    wiring: Wiring

    def run(self, seconds: float) -> Flown:
        self.kernel.advance(int(seconds * NS_PER_S))
        return self

    def path(self, row: int) -> np.ndarray:
        """(n, 4) time and true place."""
        return np.array([(at, *places[row]) for at, places in self.notes.track])


def legs(home: tuple[float, float, float], *points: tuple[float, float, float]) -> FlightPlan:
    """A mission through points (from the origin), ending in a return."""
    relative = [(e - home[0], n - home[1], u) for e, n, u in points]
    return plans.path(ORIGIN, home, relative, cruise_mps=CRUISE_MPS, end="rtl")


def wired(
    aircraft: dict[str, tuple[tuple[float, float, float], FlightPlan]],
    avoidance: Callable[[City | None], Avoidance | None],
    city: City | None = None,
    ghosts: Sequence[Ghost] = (),
    params: dict[str, float] | None = None,
    broadcast: dict[str, Any] | None = None,
    seed: int = 3,
) -> Flown:
    """Aircraft of operator blue with autopilots, a ground station and companions."""
    chance = Chance(seed)
    names = list(aircraft)
    specs = [
        VehicleSpec(name, row + 1, home_enu_m=home, params=params or {}, seed=seed)
        for row, (name, (home, _)) in enumerate(aircraft.items())
    ]
    bodies = [Body(spec.vehicle, "iris", *spec.home_enu_m, 0.0, seed=seed) for spec in specs]
    world = World(bodies, city=city, sensors=SensorSpec(0.0, magnetic_field_at(ORIGIN)))
    engine = BuiltinFleet("builtin", specs, ORIGIN, EPOCH)
    flights = [Flight(name, row + 1, plan) for row, (name, (_, plan)) in enumerate(aircraft.items())]
    station = GroundStation("blue", flights, EPOCH)
    place = (*ORIGIN.geodetic_of(0.0, 0.0), ORIGIN.alt_msl_m + ORIGIN.geoid_m)
    one = avoidance(city)
    companion = Companion(
        "companions",
        [
            CompanionSpec(
                spec.vehicle,
                spec.system_id,
                Broadcast(
                    spec.vehicle,
                    operator_place=place,
                    autopilot_location=bool(spec.params.get("DID_ENABLE")),
                    **(broadcast or {}),
                ),
                one,
                CRUISE_MPS,
            )
            for spec in specs
        ],
        ORIGIN,
        chance,
    )  # fmt: skip
    oracle = Everybody(names, ghosts)
    all_links = [link for name in names for link in (*onboard_links(name, "blue"), *oracle_links(name))]
    all_links.append(LinkSpec("approval:blue", "blue.gcs", "approval", Channel("reliable", 25 * NS_PER_MS)))
    wiring = Wiring(
        seed=seed,
        links=all_links,
        agents=[station, FlightApproval(["blue"], EPOCH, ApproveAll()), companion, oracle],
        routes=[route for name in names for route in onboard_routes(name)],
        world=world,
        engines=[EngineMount(engine, slice(None))],
    )
    notes = Notes()
    return Flown(Kernel(wiring, [notes]), notes, companion, oracle, station, wiring)
