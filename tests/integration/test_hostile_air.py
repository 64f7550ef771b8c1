"""Any bytes on the air are survived and counted, in whole runs; what cannot be is decoded, flagged and flown past."""

from __future__ import annotations

import random
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from skyrange.assembly.build import Additions
from skyrange.attack.contract import ORACLE, Attack, AttackContext, AttackPlugin
from skyrange.attack.radio import Broadcaster, transmitter, up_link
from skyrange.codec import f3411
from skyrange.codec.f3411 import BasicId, IdType, Location, MessagePack, Status, UaType
from skyrange.codec.remote_id import link_payload, noise_request
from skyrange.codec.remote_id.link_payload import RidHeader, Transport
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.params import Params
from skyrange.contracts.verdicts import Inject, Verdict
from skyrange.core.errors import DecodeError
from skyrange.core.ids import Port, endpoint
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.record import RunRecord
from skyrange.scenario.toml_files import load_text
from skyrange.study.runs import fly
from tests.integration.twin_range import heard, plain
from tests.registered_kinds import registered

pytestmark = pytest.mark.catalogue

B1, B2 = "blue/b1", "blue/b2"
KIND = "test.babble"
LAT, LON = 40.7780, -73.9550


def garbage(count: int, seed: int = 1) -> list[bytes]:
    """Bytes of many kinds: none, random, cut short, of other magic, with false sizes, giant; and bodies of noise."""
    chance = random.Random(seed)
    whole = link_payload.pack(RidHeader(Transport.WIFI_BEACON), f3411.encode(BasicId(IdType.NONE, UaType.NONE, "x")))
    found = []
    for k in range(count):
        size = chance.choice((0, 1, 23, 24, 25, 49, 200, 300, 5_000))
        noise = chance.randbytes(size)
        body = chance.randbytes(chance.choice((1, 24, 25, 26, 28, 78, 228, 229)))
        pack = bytes((0xF2, 25, chance.randrange(256))) + chance.randbytes(225)
        found.append(
            [
                noise,
                whole[: chance.randrange(len(whole))],
                bytes((chance.randrange(256),)) + whole[1:],
                whole[:12] + struct.pack("<H", chance.randrange(65_536)) + whole[14:],
                whole + b"\xff" * chance.choice((1, 65_000, 1_000_000)),
                link_payload.pack(RidHeader(chance.choice(list(Transport)), chance.randrange(256), time_ns=-5), body),
                link_payload.pack(RidHeader(chance.choice(list(Transport)), rssi_cdbm=7), pack),
                noise_request.pack(
                    noise_request.NoiseRequest(chance.randrange(-32768, 32768), 2**32 - 1, 1, 2**32 - 1, -1)
                ),
                bytes((0x1E,)) + chance.randbytes(23),
            ][k % 9]
        )
    return found


def forged() -> dict[str, bytes]:
    """Locations that no aircraft can be at, each by the flag that names it."""
    good = Location(Status.AIRBORNE, LAT, LON, alt_geo_m=17.3, speed_mps=1.0, track_deg=90)
    bodies = {}
    plain_body = bytearray(f3411.encode(good))
    for name, at, value in (
        ("lat", slice(5, 9), struct.pack("<i", 950_000_000)),
        ("status", slice(1, 2), bytes((plain_body[1] & 0x0F | 0x90,))),
        ("speed", slice(3, 4), bytes((254,))),
    ):
        body = bytearray(plain_body)
        body[at] = value
        if name == "speed":
            body[1] |= 1  # the multiplier's bit: 254 · 0.75 m/s + 63.75 m/s
        bodies[name] = bytes(body)
    return bodies


@dataclass(slots=True)
class Babble:
    """Sends payloads one after another, every 10 ms."""

    payloads: Sequence[bytes]
    turn: int = 0

    @property
    def due(self) -> Time:
        return (self.turn + 500) * 10 * NS_PER_MS

    def make(self, now: Time) -> list[bytes]:
        self.turn += 1
        return [self.payloads[(self.turn - 1) % len(self.payloads)]]


@contextmanager
def babbling(payloads: Sequence[bytes]) -> Iterator[None]:
    """An attack kind whose radio is told to send these."""

    def make(params: Params, context: AttackContext) -> Attack:
        agent = Broadcaster(context.radio, Port(context.radio, context.up), Babble(payloads))
        return Attack(agents=[agent], links=[up_link(context)], radios=[transmitter(context, (30.0, 30.0, 2.0), 20.0)])

    with registered((KIND, AttackPlugin(Params, make, "Babbles."))):
        yield


ATTACK = f'[[attacks]]\nid = "babble"\nkind = "{KIND}"\n'
EARS = '[radio]\n[[radio.receivers]]\nid = "mast"\noperator = "blue"\nplace = [30, 0, 10]\n'
AVOIDS = 'avoidance = "geometric"'


def nearby(**more: str) -> str:
    """A flight of 15 m at a height of 8 m, which ends within 40 s."""
    return plain(45, **more).replace("alt_m = 30", "alt_m = 8").replace("[60, 0]", "[15, 0]")


def flown(folder: Path, text: str, **more: Any) -> RunRecord:
    return fly(load_text(text), folder, report=False, **more)


def counts(record: RunRecord, kind: str, about: str) -> list[dict[str, Any]]:
    import json

    rows = [row for row in record.table("events").to_pylist() if row["kind"] == kind and row["about"] == about]
    return [json.loads(row["data"]) for row in rows]


def completes(record: RunRecord) -> None:
    assert record.status == "complete"
    assert {one["state"] for one in record.outcomes.values()} == {"complete"}


@pytest.mark.parametrize(
    ("stop_s", "least_sent", "least_counted"),
    [(17, 960, 512), pytest.param(30, 2_000, 1_024, marks=pytest.mark.slow)],
)
def test_an_attacker_who_sends_any_bytes_is_survived_and_counted(
    stop_s: int, least_sent: int, least_counted: int, tmp_path: Path
) -> None:
    """Counts are noted at powers of two."""
    flight = nearby if stop_s == 17 else partial(plain, 100)
    with babbling(garbage(900)):
        record = flown(tmp_path / "run", flight(radio=EARS, own=AVOIDS, more=f"{ATTACK}stop_s = {stop_s}\n"))
    completes(record)
    sent = record.rows("labels")
    assert sent > least_sent
    told = counts(record, "event.bad_broadcast", "oracle")
    assert {row["link"] for row in told} == {"rid_up:babble"}
    assert {row["why"] for row in told} == {"not a broadcast", "does not fit"}
    by_why = {
        why: max(row["count"] for row in told if row["why"] == why) for why in ("not a broadcast", "does not fit")
    }
    assert by_why["not a broadcast"] >= least_counted
    assert len(told) < 30, "noted at the 1st, 2nd, 4th … time: a flood does not fill the record"
    assert not [row for row in record.table("decisions").to_pylist() if "avoid" in row["kind"]]


@pytest.mark.slow
def test_bodies_of_noise_are_heard_and_counted_by_those_who_hear_them(tmp_path: Path) -> None:
    bodies = [one for k, one in enumerate(garbage(900, seed=2)) if k % 9 in (5, 6)]
    with babbling(bodies):
        record = flown(tmp_path / "run", plain(100, radio=EARS, own=AVOIDS, more=ATTACK + "stop_s = 30\n"))
    completes(record)
    found = heard(record, 5, 30)
    down = [frame.payload for frame in record.frames_with_payloads() if frame.link == f"rid_down:{B1}"]
    broken = sum(not readable(link_payload.unpack(payload).body) for payload in down)
    assert broken > 100
    # noted at powers of two: the last count is within a factor of two of all
    assert broken / 2 < counts(record, "event.bad_frame", B1)[-1]["count"] <= broken
    assert found["babble", B1] > 100
    assert found["babble", "mast"] > 100
    assert counts(record, "event.bad_frame", "blue")[-1]["count"] > 64, "and by the ground station, from its mast"
    assert found[B1, B2] > 5, "honest broadcasts still pass between the babble"


def readable(body: bytes) -> bool:
    try:
        f3411.decode(body)
    except DecodeError:
        return False
    return True


@dataclass(slots=True)
class Injects:
    """Puts payloads onto a link towards the companion, every 20 ms from 5 s on."""

    link: str
    payloads: Sequence[bytes] = field(default_factory=lambda: garbage(450, seed=3))
    turn: int = 0

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        return ()

    def next_wakeup(self) -> Time | None:
        return 5 * NS_PER_S + self.turn * 20 * NS_PER_MS if self.turn < 1_000 else None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        self.turn += 1
        payload = self.payloads[self.turn % len(self.payloads)]
        owner = endpoint(self.link.partition(":")[2], "companion")
        src = ORACLE if self.link.startswith("rid_down") else endpoint(self.link.partition(":")[2], "proxy")
        return [Inject(payload, "fwd", src, owner)]


@pytest.mark.parametrize("kind", ["rid_down", pytest.param("rid_data", marks=pytest.mark.slow)])
def test_garbage_on_the_companions_links_is_survived_and_counted(kind: str, tmp_path: Path) -> None:
    taps = [TapPlacement(f"{kind}:{B1}", "companion", Injects)]
    record = flown(tmp_path / "run", nearby(own=AVOIDS), additions=Additions(taps))
    completes(record)
    told = counts(record, "event.bad_frame", B1)
    assert [row["count"].bit_length() for row in told] == sorted({row["count"].bit_length() for row in told})
    assert told[-1]["count"] >= 256
    assert counts(record, "event.bad_frame", B2) == []
    assert not [row for row in record.table("decisions").to_pylist() if "avoid" in row["kind"]]


def test_what_cannot_be_reaches_the_application_decoded_and_flagged(tmp_path: Path) -> None:
    """Latitude 95°, a reserved status, 254.25 m/s: heard by all, flagged, and nobody turns away or falls."""
    bodies = forged()
    flags = {name: f3411.deviations(f3411.decode(body)) for name, body in bodies.items()}
    assert all(flags.values()), flags
    said = {name: f3411.decode(body) for name, body in bodies.items()}
    assert (said["lat"].lat_deg, said["status"].status, said["speed"].speed_mps) == (95.0, 9, 254.25)  # type: ignore[union-attr]
    who = BasicId(IdType.SERIAL_NUMBER, UaType.HELICOPTER_OR_MULTIROTOR, "LIAR")
    frames = [
        link_payload.pack(RidHeader(Transport.WIFI_BEACON, address=bytes((2, 0, 0, 0, 0, k))), pack_of(who, body))
        for k, body in enumerate(bodies.values())
    ]
    with babbling(frames):
        record = flown(tmp_path / "run", nearby(radio=EARS, own=AVOIDS, more=ATTACK + "stop_s = 17\n"))
    completes(record)
    down = [frame.payload for frame in record.frames_with_payloads() if frame.link == f"rid_down:{B1}"]
    for body in bodies.values():
        assert sum(body in payload for payload in down) > 100
    for who_hears in (B1, B2, "blue"):
        assert counts(record, "event.tracks_impossible", who_hears)[-1]["count"] >= 512
    assert not [row for row in record.table("decisions").to_pylist() if "avoid" in row["kind"]]


def pack_of(who: BasicId, location: bytes) -> bytes:
    """A pack of an identity and a Location's own bytes."""
    whole = f3411.encode(MessagePack((who, Location(Status.AIRBORNE, LAT, LON))))
    assert len(whole) == 3 + 50
    return whole[:28] + location
