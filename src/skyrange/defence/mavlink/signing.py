"""MAVLink signing at both ends of a link: frames are signed as they leave, and verified and unsigned as they arrive.

A pair of gateways, as companion computers run them for autopilots that hold no key. What is behind a gateway sees the
frames as they were before they were signed. After https://mavlink.io/en/guide/message_signing.html.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.orders import read
from skyrange.codec.mavlink.frames import CHECKSUM, HEADER_V2, LAYOUTS, MAGIC_V2, SIGNED, checksum
from skyrange.codec.mavlink.signing import (
    SignatureRefusal,
    Signer,
    SigningKey,
    is_signed,
    range_passphrase,
    secret_from_passphrase,
    signing_timestamp,
)
from skyrange.defence.path_rules import ends_at

_KINDS: Final = {
    SignatureRefusal.UNSIGNED: "signing.unsigned",
    SignatureRefusal.WRONG: "signing.wrong",
    SignatureRefusal.REPLAYED: "signing.replayed",
    SignatureRefusal.OLD: "signing.old",
    SignatureRefusal.TOO_MANY_STREAMS: "signing.streams",
}
_LINK_IDS: Final = {"gcs": 0, "companion": 1}
"""Link ids in signatures: each end has one of its own."""


@sky.defence(
    "mavlink.signing",
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
class LinkSigning(sky.EndTap):
    """Signs MAVLink on gcs links at both ends, and drops what is not signed."""

    passphrase: str = sky.param(
        "Passphrase of the key of both ends; default: skyrange/SEED/OPERATOR, as where operators sign.",
        default="", max_length=256, strict=True,
    )  # fmt: skip
    start_up_s: float = sky.param(
        "Time in seconds after its start in which unsigned frames still pass, because they left before it: more than a "
        "frame is on its way. Without effect on a defence that acts from 0 s on.",
        default=1.0, ge=0, le=60, strict=True,
    )  # fmt: skip
    seed: int
    first_timestamp: int
    """Timestamp of signatures at time 0."""
    leaving: str
    """Of a tap: the direction of frames that are signed here; the others are verified."""
    signer: Signer
    started: bool = False

    def prepare(self, context: sky.DefenceContext) -> None:
        self.seed, self.first_timestamp = context.chance.seed, signing_timestamp(context.epoch.unix_ns)

    def build(self, context: sky.DefenceContext) -> sky.Defence:
        """Taps at both ends. Raises `InputError` also for aircraft whose operator signs already."""
        vehicles = self.find_protected(context)
        for vehicle in vehicles:
            if sky.operator_of(vehicle) in context.signed:
                raise sky.InputError.one(
                    context.id, "vehicles", vehicle, "aircraft of an operator that does not sign",
                    f'Set signing = "off" for the operator {sky.operator_of(vehicle)}, or leave its aircraft out.',
                )  # fmt: skip
        rules: list[sky.PathRule] = []
        stations, companions = (ends_at("gcs", side, vehicles) for side in _LINK_IDS)
        for station, aircraft in zip(stations, companions, strict=True):
            rules += [sky.Signs(station, aircraft, "fwd"), sky.Signs(aircraft, station, "rev")]
            rules += [sky.ExpectsOrder(aircraft, "fwd"), sky.ExpectsOrder(station, "rev")]
        return sky.Defence(
            taps=[tap for side in _LINK_IDS for tap in self.place("gcs", side, vehicles, context)],
            exclusive=[sky.Exclusive(f"signatures on gcs:{vehicle}") for vehicle in vehicles],
            path_rules=rules,
        )

    def begin(self, aircraft: sky.Aircraft) -> None:
        phrase = self.passphrase or range_passphrase(self.seed, sky.operator_of(self.vehicle))
        self.leaving = "fwd" if self.side == "gcs" else "rev"
        self.signer = Signer(SigningKey(secret_from_passphrase(phrase), self.first_timestamp), _LINK_IDS[self.side])

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> Sequence[sky.Verdict]:
        """Sign a frame that leaves; drop one that arrives, or take its signature off."""
        if not self.schedule.start_ns <= now < self.schedule.stop_ns:
            return ()
        if not self.started:
            self.started = True
            self.signer.start(now)
        payload = frame.payload
        if read(payload) is None:  # no MAVLink frame: it has no place for a signature
            return () if frame.direction == self.leaving else self._refuse(now, SignatureRefusal.UNSIGNED)
        if frame.direction == self.leaving:
            fits = payload[0] == MAGIC_V2 and not is_signed(payload)
            return [sky.Replace(self.signer.sign(payload))] if fits else ()
        refusal = self.signer.check(payload)
        if refusal is None:
            return [sky.Replace(remove_signature(payload))] if is_signed(payload) else ()
        start_ns = self.schedule.start_ns
        if (
            refusal is SignatureRefusal.UNSIGNED
            and start_ns > 0
            and now < start_ns + round(self.start_up_s * sky.NS_PER_S)
        ):
            return ()
        return self._refuse(now, refusal)

    def _refuse(self, now: sky.Time, refusal: SignatureRefusal) -> Sequence[sky.Verdict]:
        return [sky.Drop(), *self.alarm.raise_at(now, _KINDS[refusal], 1.0, what=str(refusal))]


def remove_signature(frame: bytes) -> bytes:
    """The unsigned form of a whole signed frame: flag cleared, checksum recomputed, signature cut off."""
    end = HEADER_V2 + frame[1]
    number = frame[7] | frame[8] << 8 | frame[9] << 16
    covered = frame[:2] + bytes((frame[2] & ~SIGNED,)) + frame[3:end]
    return covered + checksum(covered[1:], LAYOUTS[number].crc_extra).to_bytes(CHECKSUM, "little")
