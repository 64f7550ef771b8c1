"""Message signing: byte-equal to pymavlink, and believed by the rules of mavlink.io/en/guide/message_signing.html."""

from __future__ import annotations

import copy
from hashlib import sha256
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.codec.mavlink import Deframer, Packer, decode
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.frames import LAYOUTS
from skyrange.codec.mavlink.message_columns import pack_batches, payload_dtype
from skyrange.codec.mavlink.signing import (
    MAX_LAG,
    MAX_STREAMS,
    SignatureRefusal,
    SignedConnection,
    SignedConnections,
    Signer,
    SigningKey,
    secret_from_passphrase,
    sign_frame,
    signing_timestamp,
)
from skyrange.contracts.frames import Payloads
from skyrange.contracts.mailboxes import Arrival, Inbox, Outbox
from skyrange.core.errors import DecodeError
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NS_PER_S
from tests.cases import each_case
from tests.message_columns import unpack_frames

SECRET = secret_from_passphrase("correct horse")
KEY = SigningKey(SECRET, 34_000_000_000_000)
OTHER = SigningKey(secret_from_passphrase("battery staple"), KEY.initial)


def oracle(link: int = 0, timestamp: int = KEY.initial, system: int = 255, component: int = 190) -> Any:
    """A pymavlink endpoint with the same key."""
    found = mav.MAVLink(None, srcSystem=system, srcComponent=component)
    found.signing.secret_key = SECRET
    found.signing.link_id = link
    found.signing.timestamp = timestamp
    found.signing.sign_outgoing = True
    return found


def started(key: SigningKey = KEY, link: int = 0) -> Signer:
    signer = Signer(key, link)
    signer.start(0)
    return signer


def ping(number: int = 0) -> Any:
    return mav.MAVLink_ping_message(number, number, 0, 0)


def test_a_key_is_the_sha_256_of_a_passphrase_and_time_counts_10_us_from_2015() -> None:
    assert secret_from_passphrase("abc") == sha256(b"abc").digest()
    assert signing_timestamp(1_420_070_400 * NS_PER_S) == 0
    assert signing_timestamp(1_420_070_401 * NS_PER_S + 10_000) == 100_001
    assert signing_timestamp(0) == 0
    assert signing_timestamp(10**20) == 2**48 - 1
    with pytest.raises(ValueError, match="31 bytes"):
        Signer(SigningKey(b"x" * 31, 0), 0)


@each_case("number", sorted(LAYOUTS))
def test_signed_frames_of_every_message_are_those_of_pymavlink(number: int) -> None:
    rows = np.random.default_rng(number).integers(0, 100, (1, payload_dtype(number).itemsize), dtype=np.uint8)
    frame = pack_batches([(number, rows.view(payload_dtype(number)).reshape(1), np.array([255]), np.array([0]))], 190)[
        0
    ]
    assert sign_frame(frame, SECRET, 7, KEY.initial) == decode(frame).pack(oracle(7))


def test_each_frame_raises_the_timestamp_by_one_and_pymavlink_believes_it() -> None:
    signer, reader = started(link=3), oracle()
    packer = Packer(1, 1)
    frames = [signer.sign(packer.pack(ping(n))) for n in range(5)]
    assert [int.from_bytes(frame[-12:-6], "little") - KEY.initial for frame in frames] == [0, 1, 2, 3, 4]
    assert [reader.decode(bytearray(frame)).seq for frame in frames] == [0, 1, 2, 3, 4]
    with pytest.raises(mav.MAVError):
        reader.decode(bytearray(frames[4]))


def test_what_pymavlink_signs_is_believed_once() -> None:
    signer, sender = started(), oracle(5)
    frames = [ping(n).pack(sender) for n in range(3)]
    assert signer.check(frames[0]) is None
    assert signer.check(frames[0]) is SignatureRefusal.REPLAYED
    assert signer.check(frames[2]) is None
    assert signer.check(frames[1]) is SignatureRefusal.REPLAYED, "overtaken"


def test_a_stream_is_system_component_and_link() -> None:
    signer = started()
    at = KEY.initial + 1000
    assert signer.check(ping().pack(oracle(0, at))) is None
    for other in (oracle(1, at), oracle(0, at, system=254), oracle(0, at, component=191)):
        assert signer.check(ping().pack(other)) is None
    assert signer.check(ping().pack(oracle(0, at))) is SignatureRefusal.REPLAYED


def test_a_new_stream_may_be_a_minute_behind_and_no_more() -> None:
    signer = started()
    assert signer.check(ping().pack(oracle(1, KEY.initial - MAX_LAG - 1))) is SignatureRefusal.OLD
    assert signer.check(ping().pack(oracle(1, KEY.initial - MAX_LAG))) is None
    assert signer.timestamp == KEY.initial, "an older one leaves it"


def test_the_own_timestamp_follows_what_is_believed_and_nothing_else() -> None:
    signer = started()
    wrong = Signer(OTHER._replace(initial=KEY.initial + 10**9), 0)
    wrong.start(0)
    assert signer.check(wrong.sign(Packer(1, 1).pack(ping()))) is SignatureRefusal.WRONG
    assert signer.timestamp == KEY.initial
    assert signer.streams == {}
    assert signer.check(ping().pack(oracle(0, KEY.initial + 10**6))) is None
    assert int.from_bytes(signer.sign(Packer(1, 1).pack(ping()))[-12:-6], "little") == KEY.initial + 10**6


def test_streams_are_bounded() -> None:
    signer = started()
    for link in range(MAX_STREAMS):
        assert signer.check(ping().pack(oracle(link))) is None
    assert signer.check(ping().pack(oracle(MAX_STREAMS))) is SignatureRefusal.TOO_MANY_STREAMS
    assert len(signer.streams) == MAX_STREAMS
    assert signer.check(ping().pack(oracle(0, KEY.initial + 1))) is None


def test_a_restart_forgets_streams_but_lets_nothing_of_before_pass_for_new() -> None:
    signer = started()
    at = KEY.initial + 10**9
    assert signer.check(ping().pack(oracle(0, at))) is None
    signer.start(60 * NS_PER_S)
    assert signer.streams == {}
    assert signer.check(ping().pack(oracle(0, at - 1))) is SignatureRefusal.OLD
    assert signer.check(ping().pack(oracle(0, at))) is None
    signer.start(20_000 * NS_PER_S)
    assert signer.timestamp == KEY.initial + 2 * 10**9, "the clock, where that is further"


def test_only_what_radios_say_is_believed_unsigned() -> None:
    signer, packer = started(), Packer(51, 68)
    assert signer.check(packer.pack(ping())) is SignatureRefusal.UNSIGNED
    for message in (
        mav.MAVLink_radio_status_message(1, 2, 3, 4, 5, 6, 7),
        mav.MAVLink_radio_message(1, 2, 3, 4, 5, 6, 7),
    ):
        assert signer.check(packer.pack(message)) is None
        assert signer.check(started(OTHER).sign(packer.pack(message))) is None, "a wrong signature is no worse"


@given(st.data())
def test_a_flipped_bit_is_never_believed(data: st.DataObject) -> None:
    frame = bytearray(started().sign(Packer(1, 1).pack(mav.MAVLink_heartbeat_message(2, 3, 81, 4, 3, 3))))
    place = data.draw(st.integers(0, 8 * len(frame) - 1))
    frame[place // 8] ^= 1 << place % 8
    mail = SignedConnections([PORT], [SignedConnection("blue/b1", KEY, PORT, PORT)], 0, "event.signature_refused")
    out = Outbox()
    left = mail.verify_inbox(0, (inbox := letters(bytes(frame))), inbox.columns({PORT: 0}), out)
    for payload in left.payloads:  # its checksum is wrong too: for the reader to count
        with pytest.raises(DecodeError):
            decode(payload)


# --- the boxes of an agent ------------------------------------------------------------------------

PORT = Port("blue/b1.autopilot", "autopilot:blue/b1")
PLAIN = Port("blue.gcs", "approval:blue")


def letters(*payloads: bytes, port: Port = PORT) -> Inbox:
    return Inbox([Arrival(port, 0, p, "x", FrameId(port.link, "fwd", "x", n)) for n, p in enumerate(payloads)])


def boxes(key: SigningKey = KEY) -> SignedConnections:
    return SignedConnections(
        [PORT, PLAIN], [SignedConnection("blue/b1", key, PORT, PORT)], 1, "event.signature_refused"
    )


def opened(mail: SignedConnections, inbox: Inbox, out: Outbox | None = None) -> list[bytes]:
    return list(
        mail.verify_inbox(0, inbox, inbox.columns({PORT: 0, PLAIN: 1}), out if out is not None else Outbox()).payloads
    )


def test_single_frames_are_signed_before_those_of_blocks_and_other_ports_are_left() -> None:
    packer = Packer(1, 1)
    frames = [packer.pack(ping(n)) for n in range(4)]
    out = Outbox()
    out.send(PORT, frames[0])
    out.send(PLAIN, b"{}")
    out.send_block(np.array([0, 1, 0]), Payloads.of([frames[1], b"plain", frames[2]]))
    out.send_block(np.array([1]), Payloads.of([b"plain"]))
    boxes().sign_outbox(0, out)
    each = [departure.payload for departure in out.each([PORT, PLAIN])]
    assert each == [
        sign_frame(frames[0], SECRET, 1, KEY.initial), b"{}", sign_frame(frames[1], SECRET, 1, KEY.initial + 1),
        b"plain",
        sign_frame(frames[2], SECRET, 1, KEY.initial + 2), b"plain",
    ]  # fmt: skip


def test_refused_frames_are_taken_out_counted_and_noted_ever_more_rarely() -> None:
    mail, sender, out = boxes(), oracle(), Outbox()
    good = [ping(n).pack(sender) for n in range(3)]
    bad = Packer(255, 190).pack(ping())
    inbox = letters(good[0], bad, good[1], b"\xfd rubbish", good[2], good[2], *[bad] * 9)
    assert opened(mail, inbox, out) == [good[0], good[1], b"\xfd rubbish", good[2]]
    assert mail.refused == 11
    told = [(note.kind, note.about, note.data["reason"], note.data["count"]) for note in out.notes]
    assert told == [
        ("event.signature_refused", "blue/b1", "not signed", 1),
        ("event.signature_refused", "blue/b1", "timestamp not after the last", 1),
        *(("event.signature_refused", "blue/b1", "not signed", count) for count in (2, 4, 8)),
    ]
    assert out.notes[0].causes == (FrameId(PORT.link, "fwd", "x", 1),)
    assert out.notes[0].data["message"] == "PING"


def test_mavlink_1_is_refused_but_for_radios_and_other_ports_are_not_looked_at() -> None:
    first = mav.MAVLink(None, srcSystem=255, srcComponent=190)
    old, radio = (m.pack(first, force_mavlink1=True) for m in (ping(), mav.MAVLink_radio_message(1, 2, 3, 4, 5, 6, 7)))
    assert old[0] == 0xFE
    assert opened(boxes(), letters(old, radio)) == [radio]
    assert opened(boxes(), letters(old, b"{}", port=PLAIN)) == [old, b"{}"]


def test_a_copy_goes_on_alike() -> None:
    mail, sender = boxes(), oracle()
    opened(mail, letters(ping().pack(sender)))
    again = copy.deepcopy(mail)
    more = letters(ping(1).pack(sender))
    assert opened(mail, more) == opened(again, more) != []
    assert opened(mail, more) == []


def test_signed_frames_are_read_in_columns_and_singly_as_unsigned_ones_are() -> None:
    packer = Packer(9, 1)
    frames = [packer.pack(mav.MAVLink_attitude_message(n, 1, 2, 3, 4, 5, 0)) for n in range(3)]
    signed = [sign_frame(frame, SECRET, 0, n) for n, frame in enumerate(frames)]
    (plain,), rest = unpack_frames(Payloads.of(frames))
    (read,), more = unpack_frames(Payloads.of(signed))
    assert len(rest) == len(more) == 0
    assert (read.values == plain.values).all()
    assert read.systems.tolist() == [9, 9, 9]
    assert [decode(frame).time_boot_ms for frame in signed] == [0, 1, 2]
    stream = b"".join(signed)
    assert [piece.data for piece in Deframer().feed(stream)] == signed
