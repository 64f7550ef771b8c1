"""Signature check: drops broadcasts of senders whose DRIP signatures are wrong, replayed or missing (RFC 9575)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Final, Literal

import skyrange.plugin as sky
from skyrange.codec.drip import parse_session_id
from skyrange.codec.f3411 import printable_id
from skyrange.codec.remote_id.link_payload import NO_RSSI, RidHeader, pack, unpack
from skyrange.contracts.plugins.form import param_of
from skyrange.defence.bases.receptions import ReceptionTap
from skyrange.defence.receptions import Finding, Held, Sender
from skyrange.remoteid.broadcast_profiles import sender_address
from skyrange.remoteid.drip.verification.verdicts import (
    Authorities,
    ClockError,
    Judged,
    Trust,
    Verification,
    VerificationRate,
)
from skyrange.remoteid.drip.verification.verifier import Verifier, printable_tag
from skyrange.remoteid.tracks import STALE_S

REFUSED: Final = "drip.refused"
REPLAYED: Final = "drip.replayed"
CONTRADICTED: Final = "drip.contradicted"
UNSIGNED: Final = "drip.unsigned"
OWN: Final = "drip.own"
_ALARMS: Final = {
    Trust.REFUSED: REFUSED,
    Trust.REPLAYED: REPLAYED,
    Trust.CONTRADICTED: CONTRADICTED,
    Trust.NONE: UNSIGNED,
    Trust.PARTIAL: UNSIGNED,
    Trust.UNSUPPORTED: UNSIGNED,
    Trust.TRUSTED_KEY: UNSIGNED,
}
"""Kinds of alarms about senders that are not believed. A signature that is not verified yet, or no longer fresh, is no
sign of an attack."""
GAP_NS: Final[sky.Time] = sky.from_seconds(STALE_S)
"""A sender that was not heard for so long counts as a new one, because its track is forgotten."""


@sky.defence(
    "remote_id.drip",
    surface=("rid_down",),
    place="the companion's ends of rid_down and rid_data; knows the broadcasts received, the keys of authorities, and "
    "UTC from its autopilot",
    effect="drops broadcasts that its policy disbelieves, so that avoidance sees no track of them; of an address that "
    "several use, it hands on the newest verified Location alone",
    alerts=(REFUSED, REPLAYED, CONTRADICTED, UNSIGNED, OWN),
    against=("remote_id.spoof", "remote_id.replay", "remote_id.signed_ghost"),
    evasion="relays in real time, or signs lies with a key that the registry has endorsed",
    cost="a signature verification every few seconds for each sender; no frame and no delay is added, but aircraft "
    "have to sign, and the default policy ignores those that do not",
    nominal=("drop",),
    realism={"keys": "simulated: of a registry of the range's own", "clocks": "simulated: those of autopilots"},
)
class SignatureCheck(ReceptionTap):
    """Drops Remote ID of senders whose DRIP signatures are wrong, replayed or missing."""

    decides: ClassVar = "verification of Remote ID"
    shares: ClassVar = ("verification",)

    policy: Literal["ignore-forged", "ignore-unsigned", "ignore-unverified"] = sky.param(
        "Senders whose broadcasts are dropped. ignore-forged: those that were refused, replayed or contradicted; "
        "ignore-unsigned: these and those that sign nothing; ignore-unverified: all but those with a signed Location "
        "or System message that was verified in the last 15 s.",
        default="ignore-unsigned",
    )
    authorities: Authorities = param_of(Authorities, "apex")
    clock_error_s: ClockError = param_of(ClockError, 0.0)
    verifications_per_s: VerificationRate = param_of(VerificationRate, None)
    verification: Verification
    verifier: Verifier
    address: bytes
    """Of its own broadcasts."""
    uas_id: str
    """Of its own broadcasts. A radio does not receive itself, so what has this address or id is a copy or a lie."""
    heard: Held = sky.state(Held)
    """Of each address, by a `Sender` without an id: when it was first and last heard."""

    def prepare(self, context: sky.DefenceContext) -> None:
        self.find_protected(context)
        self.verification = Verification.of(
            context.anchors(self.authorities), self.policy, self.clock_error_s, self.verifications_per_s
        )

    def build(self, context: sky.DefenceContext) -> sky.Defence:
        """Taps. Raises `InputError` also where all aircraft would be ignored."""
        made = super().build(context)
        signs = any(parse_session_id(vehicle.uas_id) is not None for vehicle in context.vehicles.values())
        if not signs and self.policy != "ignore-forged":
            expected = "an aircraft that signs its Remote ID: this policy ignores all others"
            hint = 'Give an operator or aircraft remote_id = { auth = "drip" }, or set policy = "ignore-forged".'
            raise sky.InputError.one(context.id, "policy", self.policy, expected, hint)
        return made

    def begin(self, aircraft: sky.Aircraft) -> None:
        self.verifier, self.address = Verifier([self.verification]), sender_address(self.vehicle)
        self.uas_id = aircraft.uas_id

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> Sequence[sky.Verdict]:
        """Verify a broadcast; drop it if it has a Location or a Basic ID, and is not to be acted on.

        What has neither makes no track: authentication pages pass. Of an address that several use, the newest Location
        that is verified by a broadcast is handed on in its place. Malformed payloads pass: the companion refuses them.
        """
        if frame.direction != "fwd":
            return ()
        try:
            header, body = unpack(frame.payload)
            message = sky.decode_remote_id(body)
        except sky.DecodeError:
            return ()
        sender, _ = self.reader.take(header.address, header.time_ns, None, message)
        self.verifier.set_clock(0, now, self.own.clock_us(now))
        judged = self.verifier.receive(0, now, header.address, header.counter, body, frame.id)
        verdicts: list[sky.Verdict] = [
            sky.Note(
                "event.remote_id_trust", self.vehicle, change.data, () if change.cause is None else (change.cause,)
            )
            for change in self.verifier.changes()
        ]
        heard_s = self._listen(now, header.address)
        identities = _identities(message)
        if identities is not None:
            finding = self._find(now, header.address, identities, judged, heard_s)
            if finding is not None:
                shown = sender._replace(uas_id=printable_id(sender.uas_id))
                verdicts += self.refuse(now, shown, finding)
        for released, heard_ns in self.verifier.release(0, now, judged):
            address = released.address.to_bytes(6, "big")
            if address != self.address and self.uas_id not in (_identities(sky.decode_remote_id(released.body)) or ()):
                again = pack(RidHeader(header.transport, header.channel, 0, address, NO_RSSI, heard_ns), released.body)
                verdicts.append(sky.Inject(again, "fwd", frame.src, frame.dst))
        return verdicts

    def _listen(self, now: sky.Time, address: bytes) -> float:
        """For how long a sender has been heard, in seconds."""
        who = Sender(address, "")
        times = self.heard.touch(who)
        first = times[0] if isinstance(times, tuple) and now - times[1] <= GAP_NS else now
        self.heard.put(who, (first, now))
        return float(now - first) / sky.NS_PER_S

    def _find(
        self, now: sky.Time, address: bytes, identities: Sequence[str], judged: Judged, heard_s: float
    ) -> Finding | None:
        """Why a broadcast is not to be acted on; `None` if it is."""
        number = int.from_bytes(address, "big")
        track = self.verifier.track(0, number, now)
        trust = Trust.NONE if track is None else track.state
        tag = printable_tag(None if track is None else track.tag)
        data = (("tag", tag), ("state", str(trust)))
        if address == self.address or self.uas_id in identities:
            return Finding(OWN, 1.0, data)
        if self.verifier.acts_on(0, number, now, judged):
            return None
        kind = REPLAYED if judged.is_replayed else _ALARMS.get(trust, "")
        # an honest aircraft signs something every 5 s (RFC 9575, 6.3), and some of it is lost
        if kind == UNSIGNED and (track is None or heard_s < self.verification.judges.fresh_s):
            kind = ""
        return Finding(kind, 1.0, data)


def _identities(message: object) -> list[str] | None:
    """The UAS IDs in a broadcast; `None` if it has neither these nor a Location, so that no track is made of it."""
    parts = message.messages if isinstance(message, sky.MessagePack) else (message,)
    if not any(isinstance(part, (sky.BasicId, sky.Location)) for part in parts):
        return None
    return [part.uas_id for part in parts if isinstance(part, sky.BasicId)]
