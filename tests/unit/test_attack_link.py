"""Do attacks on links do to frames what they say: when, how many, which bytes?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
from pydantic import ValidationError

from skyrange.attack.bases.shams import benign_payload
from skyrange.attack.contract import Aircraft, AttackContext, AttackPlugin
from skyrange.attack.link.eavesdrop import Eavesdropping
from skyrange.codec.mavlink import Packer, decode, dialect, message_name
from skyrange.codec.mavlink.signing import SignatureRefusal, Signer, SigningKey, sign_frame
from skyrange.contracts.components import Tap
from skyrange.contracts.frames import Fate, Frame
from skyrange.contracts.links import Act, Channel, LinkSpec, Schedule
from skyrange.contracts.mailboxes import Inbox, Note, Outbox
from skyrange.contracts.verdicts import Delay, Drop, Inject, Replace, Verdict
from skyrange.core.chance import Chance
from skyrange.core.errors import DecodeError, InputError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import Port
from skyrange.core.time import NEVER, NS_PER_MS, NS_PER_S, Epoch, Time, from_seconds
from skyrange.kernel import Kernel
from skyrange.kernel.directed_link import NOT_RANDOM, ChannelState
from skyrange.kernel.wiring import Wiring
from skyrange.record import MemoryObserver
from skyrange.testing import check_tap

BREAK = AttackPlugin.find("link.break")
CORRUPT = AttackPlugin.find("link.corrupt")
DELAY = AttackPlugin.find("link.delay")
DROP = AttackPlugin.find("link.drop")
DUPLICATE = AttackPlugin.find("link.duplicate")
EAVESDROP = AttackPlugin.find("link.eavesdrop")
FLOOD = AttackPlugin.find("link.flood")
REORDER = AttackPlugin.find("link.reorder")
REPLAY = AttackPlugin.find("link.replay")
THROTTLE = AttackPlugin.find("link.throttle")

LINK = "gcs:blue/b1"
ENDS = ("blue.gcs", "blue/b1.companion")
STATION = Packer(255, 190)
PACKER = Packer(1, 1)
POSITION = PACKER.pack(
    dialect.MAVLink_global_position_int_message(1000, 407_780_000, -739_550_000, 25_000, 5_000, 100, -50, 3, 9000)
)


def context(start_s: float = 0.0, sham: bool = False, links: Sequence[str] = (LINK, "rid_up:blue/b1")) -> AttackContext:
    return AttackContext(
        id="attack",
        vehicles={"blue/b1": Aircraft((0.0, 0.0, 0.0), "UAS")},
        links=links,
        origin=Origin(40.778, -73.955),
        epoch=Epoch(0),
        chance=Chance(5),
        duration_ns=60 * NS_PER_S,
        schedule=Schedule(from_seconds(start_s), NEVER),
        sham=sham,
    )


def tap_of(kind: AttackPlugin, start_s: float = 0.0, sham: bool = False, **params: Any) -> Tap:
    (placement,) = kind(kind.params.model_validate({"links": [LINK], **params}), context(start_s, sham)).taps
    return placement.make(LINK)


def frame(serial: int, payload: bytes = POSITION, direction: str = "rev", at: Time = 0) -> Frame:
    src, dst = ENDS if direction == "fwd" else ENDS[::-1]
    return Frame(LINK, direction, src, serial, src, dst, sent_ns=at, payload=payload)


def woken(tap: Tap, until: Time) -> list[tuple[Time, Verdict]]:
    """What a tap does on its own up to a time."""
    found: list[tuple[Time, Verdict]] = []
    now: Time = -1
    while (wish := tap.next_wakeup()) is not None and max(wish, now + 1) <= until:
        now = max(wish, now + 1)
        found += [(now, verdict) for verdict in tap.on_wakeup(now)]
    return found


ALL: list[tuple[AttackPlugin, dict[str, Any]]] = [
    (BREAK, {}),
    (CORRUPT, {"bit_error_rate": 0.01}),
    (CORRUPT, {"bit_error_rate": 0.01, "fix_checksum": True}),
    (DELAY, {"jitter_s": 1.0}),
    (DROP, {"probability": 0.5}),
    (DUPLICATE, {"copies": 3}),
    (EAVESDROP, {}),
    (FLOOD, {"message": "random", "rate_hz": 700}),
    (REORDER, {}),
    (REPLAY, {"loop": True, "record_s": 2, "drop_live": True}),
    (THROTTLE, {}),
]


@pytest.mark.catalogue
@pytest.mark.parametrize(("kind", "params"), ALL, ids=[f"{k.params.__name__}-{i}" for i, (k, _) in enumerate(ALL)])
def test_taps_conform(kind: AttackPlugin, params: dict[str, Any]) -> None:
    (placement,) = kind(kind.params.model_validate({"links": [LINK], **params}), context(3.0)).taps
    check_tap(placement.make, link=LINK)


def test_loss_has_its_share_and_depends_on_the_frame_alone() -> None:
    tap = tap_of(DROP, probability=0.3)
    dropped = {number for number in range(2000) if tap.on_frame(0, frame(number))}
    assert 0.27 < len(dropped) / 2000 < 0.33
    again = tap_of(DROP, probability=0.3)
    assert dropped == {number for number in reversed(range(2000)) if again.on_frame(0, frame(number))}
    assert tap_of(DROP).on_frame(0, frame(0)) == (Drop(),)


def test_only_selected_frames_while_it_acts() -> None:
    tap = tap_of(DROP, start_s=5.0, direction="rev", messages=["GLOBAL_POSITION_INT"])
    heartbeat = PACKER.pack(dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3))
    assert tap.on_frame(5 * NS_PER_S, frame(0)) == (Drop(),)
    assert not tap.on_frame(5 * NS_PER_S - 1, frame(1))
    assert not tap.on_frame(5 * NS_PER_S, frame(2, heartbeat))
    assert not tap.on_frame(5 * NS_PER_S, frame(3, direction="fwd"))


def test_delays_keep_the_order() -> None:
    tap = tap_of(DELAY, delay_s=1.0, jitter_s=2.0)
    untils = []
    for number in range(300):
        (verdict,) = tap.on_frame(number * NS_PER_MS, frame(number))
        assert isinstance(verdict, Delay)
        untils.append(verdict.until)
        assert number * NS_PER_MS + NS_PER_S <= verdict.until < number * NS_PER_MS + 3 * NS_PER_S
    assert untils == sorted(untils)
    assert len(set(untils)) > 3


def test_copies_come_when_they_are_due() -> None:
    tap = tap_of(DUPLICATE, after_s=0.5, copies=2)
    assert not tap.on_frame(NS_PER_S, frame(7))
    copies = woken(tap, 10 * NS_PER_S)
    assert [at for at, _ in copies] == [from_seconds(1.5), from_seconds(2.0)]
    assert {verdict for _, verdict in copies} == {Inject(POSITION, "rev", *ENDS[::-1], frame(7).id)}


def test_later_frames_overtake() -> None:
    tap = tap_of(REORDER, probability=0.5, hold_s=1.0)
    arrivals = []
    for number in range(200):
        at = number * 100 * NS_PER_MS
        verdicts = tap.on_frame(at, frame(number))
        held = verdicts[0].until if verdicts and isinstance(verdicts[0], Delay) else at
        assert held == at or NS_PER_S // 2 <= held - at <= NS_PER_S
        arrivals.append(held)
    assert arrivals != sorted(arrivals)
    assert 70 < sum(a != n * 100 * NS_PER_MS for n, a in enumerate(arrivals)) < 130


def test_a_record_is_played_with_its_own_timing() -> None:
    tap = tap_of(REPLAY, start_s=10.0, record_s=4.0, direction="rev", loop=True, drop_live=True)
    for number, at_s in enumerate([1.0, 5.9, 6.0, 7.5, 9.9]):
        assert not tap.on_frame(from_seconds(at_s), frame(number))
    assert tap.on_frame(from_seconds(10.0), frame(9)) == (Drop(),)
    played = woken(tap, from_seconds(16.0))
    assert [at / NS_PER_S for at, _ in played] == [10.0, 11.5, 13.9, 14.0, 15.5]
    parents = [verdict.parent.serial for _, verdict in played if isinstance(verdict, Inject) and verdict.parent]
    assert parents == [2, 3, 4, 2, 3]


def test_a_record_is_played_once() -> None:
    tap = tap_of(REPLAY, start_s=10.0, record_s=4.0, direction="rev")
    tap.on_frame(from_seconds(8.0), frame(0))
    assert not tap.on_frame(from_seconds(10.0), frame(1))
    assert [at for at, _ in woken(tap, 60 * NS_PER_S)] == [from_seconds(12.0)]


def test_a_throttle_queues_as_a_channel_does() -> None:
    tap = tap_of(THROTTLE, rate_bps=4800, queue_bytes=200)
    channel = ChannelState(Channel(latency_ns=1000, rate_bps=4800, queue_bytes=200))
    fates = set()
    for number in range(100):
        at = number * 30 * NS_PER_MS
        (verdict,) = tap.on_frame(at, frame(number))
        fate, arrival, _ = channel.carry(at, len(POSITION), NOT_RANDOM)
        fates.add(fate)
        assert verdict == (Delay(arrival - 1000) if fate is Fate.DELIVERED else Drop())
    assert fates == {Fate.DELIVERED, Fate.OVERFLOW}


def replaced(tap: Tap, payload: bytes, serial: int = 0) -> bytes | None:
    verdicts = tap.on_frame(0, frame(serial, payload))
    if not verdicts:
        return None
    (verdict,) = verdicts
    assert isinstance(verdict, Replace)
    return verdict.payload


def test_bits_are_flipped_at_their_rate() -> None:
    tap = tap_of(CORRUPT, bit_error_rate=0.01)
    flips = touched = 0
    for number in range(1000):
        damaged = replaced(tap, POSITION, number)
        if damaged is not None:
            touched += 1
            flips += (int.from_bytes(damaged, "big") ^ int.from_bytes(POSITION, "big")).bit_count()
            with pytest.raises(DecodeError):
                decode(damaged)
    bits = 8 * len(POSITION)
    assert flips / (1000 * bits) == pytest.approx(0.01, rel=0.06)
    assert touched / 1000 == pytest.approx(1 - 0.99**bits, abs=0.02)


def test_a_mended_checksum_has_the_value_accepted() -> None:
    damaged = replaced(tap_of(CORRUPT, bit_error_rate=1, first_byte=15, last_byte=15, fix_checksum=True), POSITION)
    assert damaged is not None
    old, new = decode(POSITION), decode(damaged)
    assert new.lat == old.lat ^ 0xFF00
    assert [new.lon, new.alt, new.hdg] == [old.lon, old.alt, old.hdg]
    whole = replaced(tap_of(CORRUPT, bit_error_rate=1, fix_checksum=True), POSITION)
    assert whole is not None
    assert whole[:10] == POSITION[:10], "the header is left"
    assert decode(whole).lat == ~old.lat


def test_a_signature_cannot_be_mended() -> None:
    key = SigningKey(b"k" * 32, 1000)
    signed = sign_frame(POSITION, key.secret, 0, 2000)
    damaged = replaced(tap_of(CORRUPT, bit_error_rate=1, first_byte=15, last_byte=15, fix_checksum=True), signed)
    assert damaged is not None
    decode(damaged)
    assert Signer(key, 0).check(signed) is None
    assert Signer(key, 0).check(damaged) is SignatureRefusal.WRONG


def test_what_is_no_frame_has_no_checksum_to_mend() -> None:
    assert replaced(tap_of(CORRUPT, bit_error_rate=1, fix_checksum=True), b"not mavlink at all") is None
    assert replaced(tap_of(CORRUPT, bit_error_rate=1, sham=True), POSITION) == POSITION


@pytest.mark.parametrize("size", [1, 11, 12, 13, 14, 40, 267, 268, 280])
def test_benign_bytes_are_as_long(size: int) -> None:
    payload = (POSITION * 8)[:size]
    benign = benign_payload(payload)
    assert len(benign) == size
    if 13 <= size <= 267:
        message = decode(benign)
        assert message_name(benign) == "ENCAPSULATED_DATA"
        assert (message.get_srcSystem(), message.get_srcComponent(), message.get_seq()) == (1, 1, POSITION[4])


def learnt(tap: Tap, payloads: Sequence[bytes], step: Time = NS_PER_S) -> list[Note]:
    notes: list[Note] = []
    for number, payload in enumerate(payloads):
        verdicts = tap.on_frame(number * step, frame(number, payload))
        made = [verdict for verdict in verdicts if isinstance(verdict, Note)]
        assert len(made) == len(verdicts), "it alters nothing"
        notes += made
    return notes


def test_what_is_learnt_is_noted_once() -> None:
    item = dialect.MAVLink_mission_item_int_message(1, 1, 3, 3, 16, 0, 1, 0.0, 0.0, 0.0, 0.0, 407_000_000, 5, 20.0)
    parameter = dialect.MAVLink_param_value_message(b"FENCE_ENABLE", 1.0, 9, 800, 4)
    payloads = [PACKER.pack(m) for m in (item, parameter, item, parameter)]
    payloads += [
        PACKER.pack(dialect.MAVLink_global_position_int_message(number, 1, 2, 25_000 + number, 0, 0, 0, 0, 0))
        for number in range(7)
    ]
    notes = learnt(tap_of(EAVESDROP), payloads)
    assert [note.data["what"] for note in notes] == ["signing", "mission_item", "parameter", "position", "position"]
    assert all(note.kind == "event.learned" and note.about == "blue/b1" for note in notes)
    assert notes[1].data["lat_deg"] == pytest.approx(40.7)
    assert (notes[2].data["name"], notes[2].data["value"]) == ("FENCE_ENABLE", 1.0)
    assert notes[3].data["alt_msl_m"] == pytest.approx(25.0)
    assert notes[1].causes == (frame(0).id,)
    changed = PACKER.pack(dialect.MAVLink_param_value_message(b"FENCE_ENABLE", 0.0, 9, 800, 4))
    tap = tap_of(EAVESDROP)
    learnt(tap, payloads)
    assert [note.data["value"] for note in learnt(tap, [changed])] == [0.0]
    assert not learnt(tap_of(EAVESDROP, sham=True), payloads)


def test_what_an_attacker_keeps_is_bounded() -> None:
    tap = tap_of(EAVESDROP)
    packs = [
        PACKER.pack(dialect.MAVLink_param_value_message(f"P{number}".encode(), 1.0, 9, 800, 4))
        for number in range(10_100)
    ]
    learnt(tap, packs, 1)
    assert isinstance(tap, Eavesdropping)
    assert len(tap.known.facts) == 10_000


@pytest.mark.parametrize(
    ("message", "rate_hz", "count"), [("PING", 7.0, 21), ("HEARTBEAT", 400.0, 1200), ("random", 12_000.0, 36_000)]
)
def test_a_flood_has_its_rate(message: str, rate_hz: float, count: int) -> None:
    tap = tap_of(FLOOD, start_s=2.0, message=message, rate_hz=rate_hz)
    sent = woken(tap, from_seconds(5.0) - 1)
    assert abs(len(sent) - count) <= 12
    assert all(from_seconds(2.0) <= at for at, _ in sent)
    payloads = [verdict.payload for _, verdict in sent if isinstance(verdict, Inject)]
    if message == "random":
        assert {len(payload) for payload in payloads} == {64}
        assert len(set(payloads)) == len(payloads)
        return
    names = {message_name(payload) for payload in payloads}
    systems = {decode(payload).get_srcSystem() for payload in payloads}
    assert names == {message}
    assert systems == ({255} if message == "PING" else set(range(2, 255)))


def test_a_flood_that_a_trigger_starts_has_its_rate() -> None:
    own = replace(context(), schedule=Schedule())
    (placement,) = FLOOD(FLOOD.params.model_validate({"links": [LINK], "rate_hz": 10}), own).taps
    tap = placement.make(LINK)
    assert tap.next_wakeup() is None
    own.schedule.start_ns = 5 * NS_PER_S
    assert tap.next_wakeup() == 5 * NS_PER_S
    late = 5 * NS_PER_S + 350 * NS_PER_MS  # a kernel asks again when the next frame passes
    assert len(tap.on_wakeup(late)) == 1
    assert tap.next_wakeup() == late + 100 * NS_PER_MS


@pytest.mark.parametrize(("towards", "side"), [("aircraft", "gcs"), ("station", "companion")])
def test_a_flood_is_placed_before_the_channel(towards: str, side: str) -> None:
    (placement,) = FLOOD(FLOOD.params.model_validate({"links": [LINK], "towards": towards}), context()).taps
    assert placement.side == side


class Talker:
    """Sends a frame every 100 ms from the station's end."""

    name = "talker"
    service_ns = NS_PER_MS
    ports: Sequence[Port] = (Port(ENDS[0], LINK),)
    due = 0

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = Outbox()
        out.send(self.ports[0], POSITION)
        self.due = now + 100 * NS_PER_MS
        return out

    def next_wakeup(self) -> Time:
        return self.due


def run(kind: AttackPlugin, params: dict[str, Any], channel: Channel, muted: bool = False) -> MemoryObserver:
    own = replace(context(links=[LINK]), schedule=Schedule())
    attack = kind(kind.params.model_validate({"links": [LINK], **params}), own)
    plan = Act("attack", NS_PER_S, 3 * NS_PER_S, muted=muted, agents=attack.agents, schedule=own.schedule)
    seen = MemoryObserver()
    wiring = Wiring(
        3,
        [LinkSpec(LINK, *ENDS, channel)],
        agents=[Talker()],
        taps=[replace(tap, attack="attack") for tap in attack.taps],
        acts=[plan],
    )
    kernel = Kernel(wiring, [seen])
    kernel.advance(4 * NS_PER_S)
    kernel.finish()
    return seen


def test_a_flood_takes_its_share_of_rate_and_queue() -> None:
    limited = Channel(latency_ns=NS_PER_MS, rate_bps=9600, queue_bytes=600)
    flood = {"message": "PARAM_REQUEST_LIST", "rate_hz": 500}
    quiet, flooded = (run(FLOOD, flood, limited, muted=muted) for muted in (True, False))
    mine = [frame for frame in flooded.frames if frame.sender == ENDS[0]]
    assert {frame.fate for frame in quiet.frames if frame.sent_ns < 3 * NS_PER_S} == {Fate.DELIVERED}
    during = [frame for frame in mine if NS_PER_S < frame.sent_ns < 3 * NS_PER_S]
    assert sum(frame.fate is Fate.OVERFLOW for frame in during) > len(during) // 2
    hostile = [frame for frame in flooded.frames if frame.sender != ENDS[0]]
    through = [frame for frame in hostile if frame.fate is Fate.DELIVERED]
    assert 0 < len(through) < 2 * 9600 / 8 / len(hostile[0].payload) + 600 / len(hostile[0].payload)
    free = run(FLOOD, flood, Channel(latency_ns=NS_PER_MS))
    assert {frame.fate for frame in free.frames if frame.sent_ns < 3 * NS_PER_S} == {Fate.DELIVERED}


def test_what_is_learnt_is_recorded_unless_muted() -> None:
    live = run(EAVESDROP, {}, Channel(latency_ns=NS_PER_MS))
    assert [(note.source, note.note.data["what"]) for note in live.notes] == [
        ("attack@gcs:blue/b1.companion", "signing"),
        ("attack@gcs:blue/b1.companion", "position"),
    ]
    assert not live.labels
    muted = run(EAVESDROP, {}, Channel(latency_ns=NS_PER_MS), muted=True)
    assert not muted.notes
    assert [f.id for f in muted.frames] == [f.id for f in live.frames]


class Notes:
    """An attack's agent that notes once a second."""

    name = "attack"
    service_ns = NS_PER_S
    ports: Sequence[Port] = ()
    due = 0

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = Outbox()
        out.note("event.test", "blue/b1")
        self.due = now + NS_PER_S
        return out

    def next_wakeup(self) -> Time:
        return self.due


@pytest.mark.parametrize(("muted", "times"), [(True, []), (False, [2, 3])])
def test_notes_of_an_attacks_agent_count_while_it_acts(muted: bool, times: list[int]) -> None:
    seen = MemoryObserver()
    plan = Act("attack", 2 * NS_PER_S, 4 * NS_PER_S, muted=muted, agents=[Notes()])
    kernel = Kernel(Wiring(1, [LinkSpec(LINK, *ENDS)], acts=[plan]), [seen])
    kernel.advance(6 * NS_PER_S)
    kernel.finish()
    assert [note.time_ns // NS_PER_S for note in seen.notes] == times


def test_outages_come_by_turns() -> None:
    tap = tap_of(BREAK, start_s=1.0, down_s=2.0, up_s=3.0)
    down = [second for second in range(14) if tap.on_frame(second * NS_PER_S, frame(second))]
    assert down == [1, 2, 6, 7, 11, 12]


def test_bad_parameters_are_named() -> None:
    with pytest.raises(InputError, match=r"gcs:blue/b9.*Did you mean 'gcs:blue/b1'"):
        tap_of(DROP, links=["gcs:blue/b9"])
    with pytest.raises(InputError, match=r"rid_up:blue/b1.*gcs, log, autopilot"):
        tap_of(FLOOD, links=["rid_up:*"])
    with pytest.raises(ValidationError, match="last_byte"):
        tap_of(CORRUPT, first_byte=9, last_byte=3)
    with pytest.raises(ValidationError, match="COMAND"):
        tap_of(DELAY, messages=["COMAND_LONG"])
