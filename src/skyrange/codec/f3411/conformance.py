"""Conformance check of F3411 messages: values that the standard does not allow, or that are saturated.

A receiver needs the values of a forged message as much as those of an honest one, so nothing is dropped: each
deviation is named, and the application decides.
"""

from __future__ import annotations

import re
from typing import Final

from skyrange.codec.f3411 import values
from skyrange.codec.f3411.messages import (
    PROTOCOL_VERSION,
    Authentication,
    BasicId,
    IdType,
    Location,
    Message,
    MessagePack,
    OperatorId,
    Reserved,
    SelfId,
    System,
)

_SERIAL: Final = re.compile(r"[0-9A-HJ-NP-Z]{4}([1-9A-F])([0-9A-HJ-NP-Z]{1,15})")
"""ANSI/CTA-2063-A: manufacturer's code, length of the rest, serial number; no letters O and I."""


def deviations(message: Message) -> tuple[str, ...]:
    """One text per deviation, `field value: what the standard says`; empty for a conforming message.

    A saturated speed (254.25 m/s, ±62 m/s) is named too: it is allowed, but it means "or more".
    """
    texts: list[str] = []
    if message.version > PROTOCOL_VERSION:
        texts.append(f"version {message.version}: reserved, {PROTOCOL_VERSION} is the newest known")
    if isinstance(message, MessagePack):
        texts += _pack(message)
    elif isinstance(message, BasicId):
        texts += _basic_id(message)
    elif isinstance(message, Location):
        texts += _location(message)
    elif isinstance(message, Authentication):
        texts += _authentication(message)
    elif isinstance(message, SelfId):
        texts += _reserved("description_type", message.description_type, 2, 200) + _printable("text", message.text)
    elif isinstance(message, System):
        texts += _system(message)
    elif isinstance(message, OperatorId):
        texts += _reserved("operator_id_type", message.operator_id_type, 0, 200)
        texts += _printable("operator_id", message.operator_id)
    elif isinstance(message, Reserved):
        texts.append(f"message type {message.message_type}: reserved, or a pack within a pack")
    return tuple(texts)


def is_serial_number(text: str) -> bool:
    """Whether `text` has the form of an ANSI/CTA-2063-A serial number, which 14 CFR 89.505 requires."""
    match = _SERIAL.fullmatch(text)
    return match is not None and int(match[1], 16) == len(match[2])


def _reserved(name: str, code: int, known: int, last: int) -> list[str]:
    """A deviation for a code above the last `known` one, up to the `last` reserved one."""
    return [f"{name} {code}: reserved"] if known < code <= last else []


def _printable(name: str, text: str) -> list[str]:
    return [] if text.isascii() and (text.isprintable()) else [f"{name} {text!r}: not plain ASCII text"]


def _beyond(name: str, value: float | None, least: float, most: float) -> list[str]:
    inside = value is None or least <= value <= most
    return [] if inside else [f"{name} {value:g}: outside {least:g}…{most:g}"]


def _pack(message: MessagePack) -> list[str]:
    texts = []
    for place, part in enumerate(message.messages):
        texts += [f"message {place}, {type(part).__name__}: {text}" for text in deviations(part)]
    kinds = [type(part) for part in message.messages]
    for kind, most in ((BasicId, 2), (Location, 1), (SelfId, 1), (System, 1), (OperatorId, 1)):
        if kinds.count(kind) > most:
            texts.append(f"{kinds.count(kind)} messages {kind.__name__}: at most {most} in a pack")
    return texts


def _basic_id(message: BasicId) -> list[str]:
    texts = _reserved("id_type", message.id_type, IdType.SPECIFIC_SESSION, 255)
    if message.id_type in (IdType.SERIAL_NUMBER, IdType.CAA_REGISTRATION):
        texts += _printable("uas_id", message.uas_id)
    if message.id_type == IdType.SERIAL_NUMBER and not is_serial_number(message.uas_id):
        texts.append(f"uas_id {message.uas_id!r}: no serial number by ANSI/CTA-2063-A")
    return texts


def _location(message: Location) -> list[str]:
    texts = _reserved("status", message.status, 4, 255)
    texts += _beyond("lat_deg", message.lat_deg, -90, 90) + _beyond("lon_deg", message.lon_deg, -180, 180)
    texts += _beyond("track_deg", message.track_deg, 0, 359)
    texts += _beyond("vertical_mps", message.vertical_mps, -values.VERTICAL_MAX_MPS, values.VERTICAL_MAX_MPS)
    texts += _beyond("timestamp_s", message.timestamp_s, 0, values.TIME_MAX_S)
    texts += _reserved("horizontal_accuracy", message.horizontal_accuracy, 12, 255)
    texts += _reserved("vertical_accuracy", message.vertical_accuracy, 6, 255)
    texts += _reserved("baro_accuracy", message.baro_accuracy, 6, 255)
    texts += _reserved("speed_accuracy", message.speed_accuracy, 4, 255)
    if message.speed_mps is not None and message.speed_mps >= values.SPEED_MAX_MPS:
        texts.append(f"speed_mps {message.speed_mps:g}: saturated, that or faster")
    if message.vertical_mps is not None and abs(message.vertical_mps) == values.VERTICAL_MAX_MPS:
        texts.append(f"vertical_mps {message.vertical_mps:g}: saturated, that or faster")
    return texts


def _authentication(message: Authentication) -> list[str]:
    texts = _reserved("auth_type", message.auth_type, 5, 9)
    if message.page == 0:
        last, length = message.last_page or 0, message.length or 0
        texts += _beyond("last_page", last, 0, 15)
        if length > 17 + 23 * last:
            texts.append(f"length {length}: {last + 1} pages hold {17 + 23 * last} bytes")
    return texts


def _system(message: System) -> list[str]:
    texts = _reserved("operator_location_type", message.operator_location_type, 2, 255)
    texts += _reserved("classification", message.classification, 1, 255)
    texts += _beyond("operator_lat_deg", message.operator_lat_deg, -90, 90)
    texts += _beyond("operator_lon_deg", message.operator_lon_deg, -180, 180)
    if message.classification == 1:
        texts += _reserved("category", message.category, 3, 255) + _reserved("ua_class", message.ua_class, 7, 255)
    return texts
