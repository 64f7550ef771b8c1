"""Checks of outboxes, shared by agents and engines: departures, notes and causes."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from skyrange.contracts.frames import Payloads
from skyrange.contracts.mailboxes import Block, Departure, Note, Outbox
from skyrange.core.ids import FrameId, Port
from skyrange.testing.rules import Broken, need, short

MAX_PAYLOAD_BYTES = 1_048_576
"""Longest payload that a departure may carry: what the longest message of any link is allowed."""
MAX_TEXT = 4_096
"""Longest text in a note: a hostile frame must not get itself written into the record whole."""
NOTE_KIND = re.compile(r"(decision|event)\.[a-z0-9_]+(\.[a-z0-9_]+)*")

Said = tuple[tuple[Departure, ...], tuple[Note, ...]]
"""What an outbox held when it was handed over."""


def said(outbox: Any, ports: Sequence[Port]) -> Said:
    """The contents of an outbox, copied, blocks frame by frame; `Broken` (rule `outbox`) unless it is whole.

    `ports` are the component's own, in its order.
    """
    expected = "an Outbox with its departures, blocks and notes in lists"
    if not isinstance(outbox, Outbox):
        raise Broken(f"answered with {short(outbox)}", expected, "outbox")
    for contents in (outbox.departures, outbox.blocks, outbox.notes):
        if not isinstance(contents, list | tuple):
            raise Broken(f"put {short(contents)} in its outbox", expected, "outbox")
    for block in outbox.blocks:
        if not isinstance(block, Block) or not isinstance(block.payloads, Payloads):
            raise Broken(f"put {short(block)} among its blocks", "a Block of places and Payloads", "outbox")
        places = block.places
        whole = isinstance(places, np.ndarray) and places.dtype == np.int64 and places.shape == (len(block.payloads),)
        if not whole or (len(places) and not 0 <= places.min() <= places.max() < len(ports)):
            raise Broken(
                f"sent a block from places {short(places)}",
                f"for each of {len(block.payloads)} payloads an int64 below {len(ports)}", "departures",
            )  # fmt: skip
    return tuple(outbox.each(ports)), tuple(outbox.notes)


def check_departures(of: Said, ports: Collection[Port]) -> None:
    """Each a `Departure` from one of `ports`, of `bytes` up to `MAX_PAYLOAD_BYTES`."""
    for departure in of[0]:
        need(isinstance(departure, Departure), f"sent {short(departure)}", "a Departure")
        need(departure.port in ports, f"sent from {departure.port}", f"one of its ports {short(tuple(ports))}")
        payload = departure.payload
        need(type(payload) is bytes, f"sent a payload of {type(payload).__name__}", "bytes")
        need(len(payload) <= MAX_PAYLOAD_BYTES, f"sent {len(payload)} bytes at once", f"at most {MAX_PAYLOAD_BYTES}")


def check_notes(of: Said) -> None:
    """Each a `Note` of kind `decision.…` or `event.…`, about somebody, with a flat mapping of scalars."""
    for note in of[1]:
        need(isinstance(note, Note), f"noted {short(note)}", "a Note")
        known = isinstance(note.kind, str) and NOTE_KIND.fullmatch(note.kind) is not None
        need(known, f"noted the kind {note.kind!r}", "decision.… or event.…, in lower case")
        need(isinstance(note.about, str) and bool(note.about), f"{note.kind} is about {note.about!r}", "an id")
        need(isinstance(note.data, Mapping), f"{note.kind} carries {short(note.data)}", "a mapping")
        for key, value in note.data.items():
            _check_scalar(f"{note.kind} {key!r}", key, value)


def _check_scalar(where: str, key: object, value: object) -> None:
    need(isinstance(key, str), f"{where} is a key of {type(key).__name__}", "text as keys")
    need(value is None or isinstance(value, str | int | float), f"{where} is {short(value)}", "a scalar")
    if isinstance(value, str):
        need(len(value) <= MAX_TEXT, f"{where} is a text of {len(value)} characters", f"at most {MAX_TEXT}")
    if isinstance(value, float):
        need(math.isfinite(value), f"{where} is {value}", "a finite number")


def check_causes(of: Said, received: Collection[FrameId]) -> None:
    """Causes are tuples of references to frames that were received."""
    for what, causes in (*((d.port, d.causes) for d in of[0]), *((n.kind, n.causes) for n in of[1])):
        need(isinstance(causes, tuple), f"{what} has causes {short(causes)}", "a tuple of FrameId")
        for cause in causes:
            need(isinstance(cause, FrameId), f"{what} is caused by {short(cause)}", "a FrameId")
            need(cause in received, f"{what} is caused by {cause}", "the ref of a frame that it received")
