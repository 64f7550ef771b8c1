"""Does the oracle carry broadcasts through the air, from rid_up to rid_down and to the ground?"""

from __future__ import annotations

import copy

import numpy as np
import pytest

from skyrange.codec.remote_id import ble, link_payload, wifi
from skyrange.codec.remote_id.link_payload import RidFrame, RidHeader, Transport
from skyrange.contracts.mailboxes import Arrival, Inbox, Outbox
from skyrange.contracts.medium import RadioSpec, Waveform
from skyrange.core.chance import Chance
from skyrange.core.errors import DecodeError, InputError
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NS_PER_MS
from skyrange.radio import ground_receptions
from skyrange.radio.builtin.listening import COMPANION
from skyrange.radio.builtin.medium import BuiltinMedium
from skyrange.radio.builtin.params import RadioEnvironment
from skyrange.radio.oracle import Oracle
from skyrange.radio.phy import MAX_BODY_BYTES, OVERHEAD_BYTES, TRANSPORT_WAVEFORM
from skyrange.testing import InputMessage, check_agent

STEP = Oracle.service_ns
NAMES = ("blue/b1", "blue/b2", "red/r1")


def oracle(recording: bool = False) -> Oracle:
    radios = [RadioSpec(name, listening=COMPANION) for name in NAMES]
    radios.append(RadioSpec("mast", (0.0, 0.0, 3.0), COMPANION))
    medium = BuiltinMedium(radios, Chance(1), surroundings=RadioEnvironment(chance=False))
    return Oracle(medium, NAMES, NAMES, {"mast": "blue"}, recording=recording)


class Still:
    """A world of aircraft that stand: 100 m apart, 40 m up."""

    vehicles = ("red/r1", "blue/b1", "nobody/n1", "blue/b2")

    def __init__(self) -> None:
        self.place = np.array([[0.0, 0.0, 40.0], [100.0, 0.0, 40.0], [0.0, 0.0, 40.0], [0.0, 100.0, 40.0]])

    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        return self.place, np.zeros((4, 3))


def arrival(owner: str, at: int, payload: bytes, serial: int = 0) -> Arrival:
    link = f"rid_up:{owner}"
    return Arrival(
        Port("oracle", link), at, payload, f"{owner}.companion", FrameId(link, "fwd", f"{owner}.companion", serial)
    )


def broadcast(transport: Transport = Transport.WIFI_BEACON, body: bytes = bytes(range(25)), counter: int = 9) -> bytes:
    return link_payload.pack(RidHeader(transport, counter=counter, address=b"\2abcde", time_ns=5), body)


def run(agent: Oracle, mail: list[Arrival], until: int = 50 * STEP) -> list[tuple[Port, bytes, int]]:
    """Everything sent, with the time of its step; the world is seen at every tick."""
    out = []
    for now in range(STEP, until + 1, STEP):
        agent.observe(now, Still())  # type: ignore[arg-type]
        due = [item for item in mail if now - STEP < item.at <= now]
        wish = agent.next_wakeup()
        if due or (wish is not None and wish <= now):
            box: Outbox = agent.step(now, Inbox(due))
            out += [(departure.port, departure.payload, now) for departure in box.each(agent.ports)]
    return out


@pytest.mark.parametrize("transport", list(Transport))
def test_a_broadcast_reaches_those_in_reach(transport: Transport) -> None:
    """Header as claimed, channel and strength as received; not to its sender; the end of the reception as its time."""
    agent = oracle()
    mail = [arrival("blue/b1", 3_000_000 + k * 7 * STEP, broadcast(transport, counter=k), k) for k in range(40)]
    out = run(agent, mail, 400 * STEP)
    links = {port.link for port, _, _ in out}
    assert links == {"rid_down:blue/b2", "rid_down:red/r1", "oracle:blue"}
    for port, payload, now in out:
        if port.link.startswith("rid_down"):
            header, body = link_payload.unpack(payload)
            assert (header.transport, header.address, body) == (transport, b"\2abcde", bytes(range(25)))
            assert now - STEP < header.time_ns <= now
            assert -9_000 < header.rssi_cdbm < -5_000
            assert header.channel == 6 if transport >= Transport.WIFI_BEACON else header.channel < 40
        else:
            for reception in ground_receptions.decode(payload).body:
                assert (reception.receiver, bytes.fromhex(reception.body)) == ("mast", bytes(range(25)))
                assert bytes.fromhex(reception.address) == b"\2abcde"
    assert agent.next_wakeup() is None
    assert not agent.refused


def test_bodies_are_who_sent_them() -> None:
    """Many at once, of all lengths, each with its own body and counter; more than the first ring holds."""
    agent = oracle()
    rng = np.random.default_rng(2)
    bodies = [rng.bytes(3 + 25 * int(rng.integers(1, 10))) for _ in range(600)]
    mail = [
        arrival(NAMES[k % 3], 1 + k * 3 * NS_PER_MS, broadcast(body=body, counter=k % 256), k)
        for k, body in enumerate(bodies)
    ]
    seen = 0
    for port, payload, _ in run(agent, mail, 250 * STEP):
        if port.link.startswith("rid_down"):
            header, body = link_payload.unpack(payload)
            assert any(bodies[k] == body for k in range(header.counter, 600, 256))
            seen += 1
    assert seen == 1_200


def test_bad_frames_are_counted_and_noted() -> None:
    agent = oracle()
    agent.observe(STEP, Still())  # type: ignore[arg-type]
    down = Port("oracle", "rid_down:blue/b1")
    wrong = [
        b"", b"\x1d", bytes(24), b"\xff" * 300, broadcast()[:-1], broadcast() + b"x",
        broadcast(Transport.BT4, bytes(24)), broadcast(Transport.BT4, bytes(53)), broadcast(body=b""),
        broadcast(body=bytes(60_000)),
    ]  # fmt: skip
    mail = [arrival("blue/b1", 5, payload, k) for k, payload in enumerate(wrong)]
    mail.append(Arrival(down, 6, broadcast(), "x", FrameId(down.link, "fwd", "x", 0)))
    outbox = agent.step(STEP, Inbox(mail))
    assert not list(outbox.each(agent.ports))
    assert sum(agent.refused.values()) == len(mail)
    assert {note.kind for note in outbox.notes} == {"event.bad_broadcast"}
    counts = {why: [note.data["count"] for note in outbox.notes if note.data["why"] == why] for why in agent.refused}
    assert counts == {"not a broadcast": [1, 2, 4], "does not fit": [1, 2, 4], "not for the air": [1]}
    assert agent.next_wakeup() is None


def test_receptions_are_recorded_with_what_they_were_of() -> None:
    agent = oracle(recording=True)
    mail = [arrival("blue/b1", 1 + k * STEP, broadcast(), k) for k in range(5)]
    out = run(agent, mail)
    kept = agent.drain_receptions()
    assert kept is not None
    rows = kept.rows
    assert len(rows.time_ns) == 15
    assert {(kept.names[n][0], s) for n, s in zip(rows.number, rows.serial.tolist(), strict=True)} == {
        (item.ref.link, item.ref.serial) for item in mail
    }
    assert {kept.radios[k] for k in rows.radio} == {"blue/b2", "mast", "red/r1"}
    for name in ("blue/b2", "red/r1"):
        mine = [k for k in range(15) if kept.radios[rows.radio[k]] == name]
        times = [
            link_payload.unpack(payload).header.time_ns for port, payload, _ in out if port.link == f"rid_down:{name}"
        ]
        assert rows.time_ns[mine].tolist() == times
    assert agent.drain_receptions() is None


def test_a_late_step_takes_frames_as_of_now() -> None:
    agent = oracle()
    agent.observe(STEP, Still())  # type: ignore[arg-type]
    agent.step(5 * STEP, Inbox([]))
    outbox = agent.step(6 * STEP, Inbox([arrival("blue/b1", 2 * STEP, broadcast())]))
    assert len(list(outbox.each(agent.ports))) == 3


def test_a_copy_goes_on_alike() -> None:
    trunk = oracle(recording=True)
    run(trunk, [arrival("blue/b1", 1, broadcast(Transport.BT5))], STEP)
    branch = copy.deepcopy(trunk)
    more = [arrival("red/r1", 2 * STEP, broadcast())]
    assert run(trunk, more) == run(branch, more) != []


def test_names_without_a_radio_are_an_error() -> None:
    medium = oracle().medium
    with pytest.raises(InputError, match=r"blue/b1") as caught:
        Oracle(medium, ["blue/b11"], ["nope"], {"masd": "blue"})
    assert len(caught.value.problems) == 3


def test_frames_are_as_long_as_the_codecs() -> None:
    """Of every transport: the PDU's or MAC frame's length around bodies of 25 to 253 bytes."""
    for size in (25, 28, 53, 228):
        frame = RidFrame(RidHeader(Transport.WIFI_BEACON, channel=6), bytes(size))
        assert len(wifi.encode_beacon(frame)) == OVERHEAD_BYTES[Transport.WIFI_BEACON] + size
        assert len(wifi.encode_nan_action(frame)) == OVERHEAD_BYTES[Transport.WIFI_NAN] + size
        assert len(ble.encode_auxiliary(frame)) - 10 == OVERHEAD_BYTES[Transport.BT5] + size
    assert OVERHEAD_BYTES[Transport.BT4] + 25 == 37
    assert MAX_BODY_BYTES[Transport.BT5] >= 228
    assert [Waveform(w) for w in TRANSPORT_WAVEFORM[1:]] == [
        Waveform.BLE_1M,
        Waveform.BLE_CODED,
        Waveform.OFDM_6M,
        Waveform.OFDM_6M,
    ]


def test_ground_receptions_survive_bytes() -> None:
    for payload in (b"", b"{}", b"[" * 100_000, b'{"body":[{"rssi_dbm":NaN}]}', b"\xff" * 20, bytes(2_000_000)):
        with pytest.raises(DecodeError):
            ground_receptions.decode(payload)


def test_it_is_an_agent() -> None:
    def make() -> Oracle:
        agent = oracle()
        agent.observe(0, Still())  # type: ignore[arg-type]
        return agent

    mail = [
        InputMessage(
            k * 13 * NS_PER_MS, Port("oracle", f"rid_up:{NAMES[k % 3]}"), broadcast(transport, counter=k % 256)
        )
        for k, transport in enumerate(list(Transport) * 30)
    ]
    check_agent(make, mail=mail)


def test_a_frame_goes_at_the_time_in_its_header_but_is_not_held_long() -> None:
    """A radio sends by its own clock what it was given a little ahead; a time long ahead or past counts for nothing."""
    for ahead_ns, wait_ns in ((30 * NS_PER_MS, 30 * NS_PER_MS), (10 * 1000 * NS_PER_MS, 0), (-5 * NS_PER_MS, 0)):
        at = 3 * STEP + 1
        payload = link_payload.pack(RidHeader(Transport.WIFI_BEACON, counter=1, time_ns=at + ahead_ns), bytes(25))
        ends = [
            link_payload.unpack(payload).header.time_ns
            for port, payload, _ in run(oracle(), [arrival("blue/b1", at, payload)], 20 * STEP)
            if port.link.startswith("rid_down")
        ]
        assert ends
        assert all(wait_ns < end - at < wait_ns + 2 * NS_PER_MS for end in ends)
