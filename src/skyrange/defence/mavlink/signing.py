"""MAVLink signing at both ends of a link: frames are signed as they leave, and verified and unsigned as they arrive.

A pair of gateways, as companion computers run them for autopilots that hold no key. What is behind a gateway sees the
frames as they were before they were signed. After https://mavlink.io/en/guide/message_signing.html.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from pydantic import Field

from skyrange.attack.bases.mavlink_orders import read
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.on_path import TapMaker
from skyrange.codec.mavlink.frame_layout import CHECKSUM, HEADER_V2, LAYOUTS, MAGIC_V2, SIGNED, checksum
from skyrange.codec.mavlink.signing import (
    SignatureRefusal,
    Signer,
    SigningKey,
    is_signed,
    range_passphrase,
    secret_from_passphrase,
    signing_timestamp,
)
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.verdicts import Drop, Replace, Verdict
from skyrange.core.errors import InputError
from skyrange.core.ids import link_name, operator_of
from skyrange.core.time import NS_PER_S, Time
from skyrange.defence.contract import Defence, DefenceContext, DefencePlugin
from skyrange.defence.path_rules import ExpectsOrder, PathRule, Signs, ends_at
from skyrange.defence.placement import Alarm, DefenceTap, Protected, find_protected, place_taps

_KINDS: Final = {
    SignatureRefusal.UNSIGNED: "signing.unsigned",
    SignatureRefusal.WRONG: "signing.wrong",
    SignatureRefusal.REPLAYED: "signing.replayed",
    SignatureRefusal.OLD: "signing.old",
    SignatureRefusal.TOO_MANY_STREAMS: "signing.streams",
}
_LINK_IDS: Final = {"gcs": 0, "companion": 1}
"""Link ids in signatures: each end has one of its own."""


class LinkSigning(Protected):
    """Whose gcs links are signed."""

    passphrase: str = Field(
        default="",
        max_length=256,
        strict=True,
        description="Passphrase of the key of both ends; default: skyrange/SEED/OPERATOR, as where operators sign.",
    )
    start_up_s: float = Field(
        default=1.0,
        ge=0,
        le=60,
        strict=True,
        description="Time in seconds after its start in which unsigned frames still pass, because they left before it: "
        "more than a frame is on its way. Without effect on a defence that acts from 0 s on.",
    )


def remove_signature(frame: bytes) -> bytes:
    """The unsigned form of a whole signed frame: flag cleared, checksum recomputed, signature cut off."""
    end = HEADER_V2 + frame[1]
    number = frame[7] | frame[8] << 8 | frame[9] << 16
    covered = frame[:2] + bytes((frame[2] & ~SIGNED,)) + frame[3:end]
    return covered + checksum(covered[1:], LAYOUTS[number].crc_extra).to_bytes(CHECKSUM, "little")


@dataclass(slots=True)
class SigningTap(DefenceTap):
    """One end of a signed link."""

    leaving: str
    """The direction of frames that are signed here; the others are verified."""
    signer: Signer
    alarm: Alarm
    schedule: Schedule
    start_up_ns: Time
    started: bool = field(default=False)

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Sign a frame that leaves; drop one that arrives, or take its signature off."""
        if not self.schedule.start_ns <= now < self.schedule.stop_ns:
            return ()
        if not self.started:
            self.started = True
            self.signer.start(now)
        payload = frame.payload
        if read(payload) is None:  # no MAVLink frame: it has no place for a signature
            return () if frame.direction == self.leaving else [Drop(), *self._report(now, SignatureRefusal.UNSIGNED)]
        if frame.direction == self.leaving:
            fits = payload[0] == MAGIC_V2 and not is_signed(payload)
            return [Replace(self.signer.sign(payload))] if fits else ()
        refusal = self.signer.check(payload)
        if refusal is None:
            return [Replace(remove_signature(payload))] if is_signed(payload) else ()
        start_ns = self.schedule.start_ns
        if refusal is SignatureRefusal.UNSIGNED and start_ns > 0 and now < start_ns + self.start_up_ns:
            return ()
        return [Drop(), *self._report(now, refusal)]

    def _report(self, now: Time, refusal: SignatureRefusal) -> Sequence[Verdict]:
        return self.alarm.raise_at(now, _KINDS[refusal], 1.0, what=str(refusal))


@dataclass(frozen=True, slots=True)
class _Maker:
    """Makes the tap of one end of a link."""

    keys: tuple[tuple[str, str, SigningKey], ...]
    """Link, vehicle id and key."""
    side: str
    schedule: Schedule
    start_up_ns: Time

    def __call__(self, link: str) -> SigningTap:
        vehicle, key = next((one, own) for name, one, own in self.keys if name == link)
        leaving = "fwd" if self.side == "gcs" else "rev"
        signer = Signer(key, _LINK_IDS[self.side])
        return SigningTap(link, leaving, signer, Alarm(vehicle), self.schedule, self.start_up_ns)


def make(params: LinkSigning, context: DefenceContext) -> Defence:
    """The parts. Raises `InputError` for aircraft that are not in the scenario, or whose operator signs already."""
    vehicles = find_protected(params, context)
    for vehicle in vehicles:
        if operator_of(vehicle) in context.signed:
            raise InputError.one(
                context.id, "vehicles", vehicle, "aircraft of an operator that does not sign",
                f'Set signing = "off" for the operator {operator_of(vehicle)}, or leave its aircraft out.',
            )  # fmt: skip
    initial = signing_timestamp(context.epoch.unix_ns)
    keys = []
    for vehicle in vehicles:
        phrase = params.passphrase or range_passphrase(context.chance.seed, operator_of(vehicle))
        keys.append((link_name("gcs", vehicle), vehicle, SigningKey(secret_from_passphrase(phrase), initial)))
    taps = []
    for side in _LINK_IDS:
        maker = _Maker(tuple(keys), side, context.schedule, round(params.start_up_s * NS_PER_S))
        taps += place_taps("gcs", side, vehicles, context, TapMaker(maker))
    rules: list[PathRule] = []
    for station, aircraft in zip(ends_at("gcs", "gcs", vehicles), ends_at("gcs", "companion", vehicles), strict=True):
        rules += [Signs(station, aircraft, "fwd"), Signs(aircraft, station, "rev")]
        rules += [ExpectsOrder(aircraft, "fwd"), ExpectsOrder(station, "rev")]
    exclusive = [Exclusive(f"signatures on gcs:{vehicle}") for vehicle in vehicles]
    return Defence(taps=taps, exclusive=exclusive, path_rules=rules)


SIGNING = DefencePlugin(
    LinkSigning,
    make,
    "Signs MAVLink on gcs links at both ends, and drops what is not signed.",
    surface=("gcs",),
    place="both ends of the gcs link, which share a key",
    effect="drops frames that are not signed, wrongly signed, repeated or old",
    alerts=tuple(_KINDS.values()),
    against=("mavlink.*", "link.replay", "link.corrupt", "identity.keep_alive", "telemetry.*"),
    evasion="has the key, is behind an end, as on board or in the station, or drops and delays what is signed",
    cost="13 bytes in each frame; a hash at each end",
    nominal=("replace",),
    realism={
        "signatures": "cited: https://mavlink.io/en/guide/message_signing.html",
        "keys": "assumed: shared before the flight",
    },
)
