"""Hostile input: bytes that an adversary would try, and how much may be sent in answer.

The same bytes every time: no chance, so a finding repeats.
Garbage is what no decoder should take; forged is what every MAVLink decoder must take, since its
checksum is right, with whatever numbers in it; spoiled is the component's own friendly mail, broken.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from hashlib import shake_256
from typing import Any

from skyrange.codec.mavlink import Packer, dialect
from skyrange.codec.mavlink.frames import LAYOUTS
from skyrange.core.ids import Port
from skyrange.core.time import Time
from skyrange.testing.drivers.messages import InputMessage
from skyrange.testing.rules import need

HUGE_BYTES = 1_000_000
"""Almost the longest payload that a link carries."""


MAX_ANSWERS = 1
"""Departures, and notes, that one frame of garbage may cause."""
MAX_ANSWER_BYTES = 2_048
"""Bytes that one frame of garbage may cause, beyond its own length."""
Volume = tuple[int, int, int]
"""Departures, notes, bytes."""


def noise(label: str, size: int) -> bytes:
    """`size` bytes that look random and depend on `label` alone (SHAKE-256)."""
    return shake_256(label.encode()).digest(size)


def garbage() -> list[bytes]:
    """Bytes that are no whole message of any link: empty, random, cut, bent, nested, huge."""
    whole = Packer(255, 190).pack(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    texts = [
        b"{}",
        b"[" * 20_000,
        b'{"method":"PUT","path":"/v1/operational_intents/","body":{"volumes":[1e999,-1e999]}}',
        b'{"status":200,"path":"","body":{"id":9999999999999999999999}}',
        b'{"a":"\xff\xfe"}',
        "\u202e\x00\ud7ff".encode(),
    ]
    return [
        b"",
        *(bytes([value]) for value in (0x00, 0x7B, 0xFD, 0xFE, 0xFF)),
        *(noise(f"noise {size}", size) for size in (2, 8, 12, 17, 64, 280, 1_500, 70_000)),
        *(whole[:size] for size in range(1, len(whole))),
        *(b"\xfd" + noise(f"header {number}", 20) for number in range(8)),
        whole[:-1] + bytes([whole[-1] ^ 0xFF]),
        whole + whole,
        *texts,
        noise("huge", HUGE_BYTES),
        b"\xfd" * HUGE_BYTES,
    ]


def forged(target_systems: Sequence[int] = (0, 1)) -> Iterator[bytes]:
    """Every message of the dialect with a right checksum and senseless fields, to each target in turn.

    Random bits as floats give NaN, infinities and denormals; all ones and all zeros give the ends of
    every integer. Sent as ground station 255/190 and as 1/1.
    """
    packers = [Packer(255, 190), Packer(1, 1)]
    for number, layout in sorted(LAYOUTS.items()):
        for turn, body in enumerate((noise(f"body {number}", layout.size), b"\xff" * layout.size, bytes(layout.size))):
            fields = _fields(layout, body)
            if "target_system" in fields:
                fields["target_system"] = target_systems[(number + turn) % len(target_systems)]
            if "target_component" in fields:
                fields["target_component"] = turn
            yield packers[turn % 2].pack(layout.cls(**fields))


def _fields(layout: Any, body: bytes) -> dict[str, Any]:
    values = layout.unpack(body)
    fields: dict[str, Any] = {}
    for name, start, stop, kind in layout.fields:
        if kind == "text":
            fields[name] = bytes(values[start]).rstrip(b"\0")
        else:
            fields[name] = values[start:stop] if kind == "array" else values[start]
    return fields


def spoiled(messages: Sequence[InputMessage], most: int = 24) -> list[bytes]:
    """The first `most` different payloads of `messages`, each cut in half, without its last byte, bent, and doubled."""
    payloads = list(dict.fromkeys(message.payload for message in messages))[:most]
    spoilt = []
    for payload in payloads:
        middle = len(payload) // 2
        bent = payload[:middle] + bytes([payload[middle] ^ 0x55]) + payload[middle + 1 :] if payload else b""
        spoilt += [payload[:middle], payload[:-1], bent, payload + payload]
    return spoilt


def address_to_ports(
    payloads: Sequence[bytes], ports: Sequence[Port], begin: Time, spacing: Time, at_once: int
) -> list[InputMessage]:
    """All payloads to every port, `at_once` of them every `spacing` ns from `begin` on."""
    return [
        InputMessage(begin + spacing * (number // at_once), port, payload)
        for number, payload in enumerate(payloads)
        for port in ports
    ]


def short_garbage() -> list[bytes]:
    """The garbage that is no longer than the answer to it may be."""
    return [payload for payload in garbage() if len(payload) <= MAX_ANSWER_BYTES]


def check_modest(quiet: Volume, loud: Volume, payloads: Sequence[bytes], ports: int) -> None:
    """`Broken` where `payloads`, sent to each of `ports`, made `loud` out of `quiet` beyond the bounds."""
    frames, received = len(payloads) * ports, sum(map(len, payloads)) * ports
    bounds = (MAX_ANSWERS * frames, MAX_ANSWERS * frames, received + MAX_ANSWER_BYTES * frames)
    for what, base, count, most in zip(("departures", "notes", "bytes"), quiet, loud, bounds, strict=True):
        need(count - base <= most, f"{count - base} {what} more for {frames} frames of garbage", f"at most {most}")
