"""Compromised ground station: it leads all its aircraft to one place, and shows its operator the plan.

The attacker's program is within the station: it sends in the station's own stream of frames, with the station's own
sequence numbers and key. So system ids, signatures and sources prove nothing against it. It also answers the operator's
orders itself, and rewrites telemetry before the station's software reads it.
"""

from __future__ import annotations

from typing import Final

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.compromised_sender import SenderStream, command_of, redirect_order, without_signature
from skyrange.attack.bases.mavlink.leading import Leader
from skyrange.attack.bases.mavlink.message_fields import read_fields, write_alteration
from skyrange.attack.bases.mavlink.orders import NOBODY, Sender
from skyrange.attack.bases.mavlink.telemetry import AUTOPILOT, exclusive_messages
from skyrange.attack.bases.on_path import CopyForLink
from skyrange.attack.ground.shown_flight import SHOWN_MESSAGES, ShownFlight
from skyrange.attack.tapped_links import MESSAGE_NUMBERS, ends_of
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.signing import range_passphrase, secret_from_passphrase

_SHOWN: Final = {MESSAGE_NUMBERS[name]: name for name in SHOWN_MESSAGES}


@sky.attack(
    "ground.insider",
    technique="T0831",
    surface=("gcs",),
    persists="mode",
    effect="the whole fleet meets at one place, its operator sees it fly the plan, and no signature fails",
    knowledge="the plans that the station uploads and the telemetry that it receives",
    position="within the ground station: a malicious operator or program, or a remote access to the computer",
    equipment="the station itself, with its links, its system id and its signing key",
    budget="two frames per second and aircraft; all telemetry with a position or a mode is rewritten",
    load="the sham: the same frames, addressed to a system that is not there, and telemetry as it is",
    content="a place on the plan of each aircraft",
    placement="the station of another operator",
)
class Insider(sky.LinkTap):
    """Has a ground station lead all its aircraft to one place, while its displays show the plan.

    The sham sends as many frames and addresses them to nobody, and lets the operator's orders and telemetry be.
    """

    operator: str = sky.param("Operator whose ground station is compromised, such as 'blue'.")
    at: sky.Enu = sky.param(
        "Place that all aircraft of the operator are led to, [east_m, north_m, up_m] in metres from the origin or the "
        "attack's anchor."
    )
    every_s: sky.Number = sky.param(
        "Time between two targets for each aircraft, in seconds.", default=0.5, ge=0.1, le=10
    )
    fleet: dict[str, sky.Aircraft]
    origin: sky.Origin
    leader: Leader
    shown: ShownFlight
    system: int
    """System id of the aircraft on the link."""
    up: SenderStream
    down: SenderStream
    answers: sky.MavlinkPacker
    """Makes acknowledgements in the name of the aircraft."""

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """A tap at the station on each link. Raises `InputError` for an operator that is not in the scenario."""
        self.origin = context.origin
        self.fleet = {name: one for name, one in context.vehicles.items() if sky.operator_of(name) == self.operator}
        if not self.fleet:
            operators = sorted({sky.operator_of(vehicle) for vehicle in context.vehicles})
            hint = sky.nearest(self.operator, operators)
            raise sky.InputError.one(context.id, "operator", self.operator, "an operator of the scenario", hint)
        links, make = [sky.link_name("gcs", vehicle) for vehicle in self.fleet], CopyForLink(self)
        exclusive = [sky.Exclusive(f"ground station of {self.operator}")]
        exclusive += [exclusive_messages(link, "rev", SHOWN_MESSAGES) for link in links]
        taps = [sky.TapPlacement(link, "gcs", make) for link in links]
        return sky.Attack(taps=taps, shown={"meeting point": self.at}, exclusive=exclusive)

    def begin(self) -> None:
        """Take the aircraft on the link, and the key of the station."""
        aircraft = self.fleet[self.link.partition(":")[2]]
        self.system = aircraft.system_id
        secret = secret_from_passphrase(range_passphrase(self.chance.seed, self.operator))
        self.up, self.down = SenderStream(secret), SenderStream(secret)
        self.answers = sky.MavlinkPacker(self.system, AUTOPILOT)
        sender = Sender(sky.MavlinkPacker(*sky.STATION), NOBODY if self.sham else self.system, True)
        self.leader = Leader(
            sender, self.schedule, self.origin, (self.at,), 1.0, sky.from_seconds(self.every_s), lands=False
        )
        self.shown = ShownFlight(self.origin, aircraft.start_enu_m)

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
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
        return [sky.Replace(sent)] if acts and content is not None else _replace(frame.payload, sent)

    def next_wakeup(self) -> sky.Time | None:
        return self.leader.due

    def on_wakeup(self, now: sky.Time) -> sky.Verdicts:
        """Send the target, after a change of mode where one is needed."""
        return [sky.Inject(self.up.add(one), way, *ends_of(self.link, way)) for way, one in self.leader.make(now)]

    def _hold_back(self, payload: bytes) -> sky.Verdicts:
        """Address an order of the operator to nobody, and acknowledge it; nothing for any other frame."""
        content = redirect_order(payload, self.sham)
        if content is None:
            return []
        verdicts: list[sky.Verdict] = [sky.Replace(self.up.forward(payload, content))]
        command = command_of(payload)
        if command is not None:
            answer = mav.MAVLink_command_ack_message(
                command, mav.MAV_RESULT_ACCEPTED, target_system=NOBODY if self.sham else sky.STATION[0],
                target_component=sky.STATION[1],
            )  # fmt: skip
            verdicts.append(sky.Inject(self.down.add(self.answers.pack(answer)), "rev", *ends_of(self.link, "rev")))
        return verdicts

    def _shown(self, now: sky.Time, payload: bytes) -> bytes | None:
        """The frame of telemetry that is shown instead, without a signature; `None` where it stays as it is."""
        number = sky.message_id(payload)
        if number is None or number not in _SHOWN:
            return None
        plain = without_signature(payload)
        fields = None if plain is None else read_fields(plain, number)
        if plain is None or fields is None or plain[5] != self.system or plain[6] != AUTOPILOT:
            return None
        true = fields.copy()
        if not self.shown.alter(_SHOWN[number], fields, now - self.schedule.start_ns):
            return None
        return write_alteration(plain, number, true, fields, self.sham)


def _replace(payload: bytes, sent: bytes) -> sky.Verdicts:
    return [] if sent == payload else [sky.Replace(sent)]
