"""Compromised ground station: it leads all its aircraft to one place, and shows its operator the plan.

The attacker's program is within the station: it sends in the station's own stream of frames, with the station's own
sequence numbers and key. So system ids, signatures and sources prove nothing against it. It also answers the operator's
orders itself, and rewrites telemetry before the station's software reads it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from pydantic import Field

from skyrange.attack.bases.leading import Leader
from skyrange.attack.bases.mavlink_orders import NOBODY, STATION, Sender
from skyrange.attack.compromised_sender import SenderStream, command_of, redirect_order, without_signature
from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, Place, ThreatModel
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.ground.shown_flight import ShownFlight
from skyrange.attack.on_path import ends_of
from skyrange.attack.telemetry.alteration import exclusive_messages, read_fields, write_fields
from skyrange.codec.mavlink import Packer, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.signing import range_passphrase, secret_from_passphrase
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule, TapPlacement
from skyrange.contracts.params import Enu, Number, Params
from skyrange.contracts.verdicts import Inject, Replace, Verdict
from skyrange.core.errors import InputError, nearest
from skyrange.core.ids import link_name, operator_of
from skyrange.core.time import Time, from_seconds

_AUTOPILOT: Final = int(mav.MAV_COMP_ID_AUTOPILOT1)


class Insider(Params):
    """Where the fleet is led."""

    operator: str = Field(description="Operator whose ground station is compromised, such as 'blue'.")
    at: Enu = Field(
        description="Place that all aircraft of the operator are led to, [east_m, north_m, up_m] in metres from the "
        "origin or the attack's anchor."
    )
    every_s: Number = Field(
        default=0.5, ge=0.1, le=10, description="Time between two targets for each aircraft, in seconds."
    )


@dataclass(slots=True)
class InsiderTap:
    """The attacker's program in the station, on the link with one aircraft.

    The sham sends as many frames and addresses them to nobody, and lets the operator's orders and telemetry be.
    """

    link: str
    system: int
    schedule: Schedule
    sham: bool
    leader: Leader
    shown: ShownFlight
    up: SenderStream
    down: SenderStream
    answers: Packer
    """Makes acknowledgements in the name of the aircraft."""

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Hold back the operator's orders, and alter telemetry."""
        self.leader.see(now, frame)
        acts = self.schedule.start_ns <= now < self.schedule.stop_ns
        if frame.direction == "fwd":
            self.shown.learn(frame.payload)
            if acts and (verdicts := self._hold_back(frame.payload)):
                return verdicts
            return _replace(frame.payload, self.up.forward(frame.payload))
        content = self._shown(now, frame.payload)
        sent = self.down.forward(frame.payload, content if acts else None)
        return [Replace(sent)] if acts and content is not None else _replace(frame.payload, sent)

    def next_wakeup(self) -> Time | None:
        """When the next target is due."""
        return self.leader.due

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Send the target, after a change of mode where one is needed."""
        return [Inject(self.up.add(one), way, *ends_of(self.link, way)) for way, one in self.leader.make(now)]

    def _hold_back(self, payload: bytes) -> Sequence[Verdict]:
        """Address an order of the operator to nobody, and acknowledge it; nothing for any other frame."""
        content = redirect_order(payload, self.sham)
        if content is None:
            return []
        verdicts: list[Verdict] = [Replace(self.up.forward(payload, content))]
        command = command_of(payload)
        if command is not None:
            answer = mav.MAVLink_command_ack_message(
                command, mav.MAV_RESULT_ACCEPTED, target_system=NOBODY if self.sham else STATION[0],
                target_component=STATION[1],
            )  # fmt: skip
            verdicts.append(Inject(self.down.add(self.answers.pack(answer)), "rev", *ends_of(self.link, "rev")))
        return verdicts

    def _shown(self, now: Time, payload: bytes) -> bytes | None:
        """The frame of telemetry that is shown instead, without a signature; `None` where it stays as it is."""
        number = message_id(payload)
        if number is None or number not in self.shown.messages:
            return None
        plain = without_signature(payload)
        fields = None if plain is None else read_fields(plain, number)
        if plain is None or fields is None or plain[5] != self.system or plain[6] != _AUTOPILOT:
            return None
        true = fields.copy()
        if not self.shown.alter(now - self.schedule.start_ns, number, fields):
            return None
        length = max(len(true.tobytes().rstrip(b"\0")), len(fields.tobytes().rstrip(b"\0")))
        return write_fields(plain, number, true if self.sham else fields, length)


def _replace(payload: bytes, sent: bytes) -> Sequence[Verdict]:
    return [] if sent == payload else [Replace(sent)]


@dataclass(frozen=True, slots=True)
class _MakeTap:
    params: Insider
    context: AttackContext

    def __call__(self, link: str) -> InsiderTap:
        params, context = self.params, self.context
        vehicle = link.partition(":")[2]
        aircraft = context.vehicles[vehicle]
        secret = secret_from_passphrase(range_passphrase(context.chance.seed, params.operator))
        sender = Sender(Packer(*STATION), NOBODY if context.sham else aircraft.system_id, True)
        track: tuple[Place, ...] = (params.at,)
        leader = Leader(
            sender, context.schedule, context.origin, track, 1.0, from_seconds(params.every_s), lands=False
        )  # fmt: skip
        return InsiderTap(
            link, aircraft.system_id, context.schedule, context.sham, leader,
            ShownFlight(context.origin, aircraft.start_enu_m), SenderStream(secret), SenderStream(secret),
            Packer(aircraft.system_id, _AUTOPILOT),
        )  # fmt: skip


def make(params: Insider, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for an operator that is not in the scenario."""
    fleet = [vehicle for vehicle in context.vehicles if operator_of(vehicle) == params.operator]
    if not fleet:
        operators = sorted({operator_of(vehicle) for vehicle in context.vehicles})
        hint = nearest(params.operator, operators)
        raise InputError.one(context.id, "operator", params.operator, "an operator of the scenario", hint)
    maker = _MakeTap(params, context)
    taps = [TapPlacement(link_name("gcs", vehicle), "gcs", maker) for vehicle in fleet]
    shown = ShownFlight(context.origin, (0.0, 0.0, 0.0)).messages
    exclusive = [Exclusive(f"ground station of {params.operator}")]
    exclusive += [exclusive_messages(link_name("gcs", vehicle), "rev", shown) for vehicle in fleet]
    return Attack(taps=taps, shown={"meeting point": params.at}, exclusive=exclusive)


INSIDER = AttackPlugin(
    Insider,
    make,
    "Has a ground station lead all its aircraft to one place, while its displays show the plan.",
    technique="T0831",
    surface=("gcs",),
    persists="mode",
    effect="the whole fleet meets at one place, its operator sees it fly the plan, and no signature fails",
    threat=ThreatModel(
        knowledge="the plans that the station uploads and the telemetry that it receives",
        position="within the ground station: a malicious operator or program, or a remote access to the computer",
        equipment="the station itself, with its links, its system id and its signing key",
        budget="two frames per second and aircraft; all telemetry with a position or a mode is rewritten",
    ),
    controls=Controls(
        load="the sham: the same frames, addressed to a system that is not there, and telemetry as it is",
        content="a place on the plan of each aircraft",
        placement="the station of another operator",
    ),
)
