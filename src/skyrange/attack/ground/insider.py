"""Compromised ground station: it leads all its aircraft to one place, and shows its operator the plan."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.compromised_sender import (
    SenderStream,
    acknowledge,
    command_of,
    redirect_order,
    station_key,
)
from skyrange.attack.bases.mavlink.leading import Leader
from skyrange.attack.bases.mavlink.orders import Sender
from skyrange.attack.bases.mavlink.telemetry import AUTOPILOT, exclusive_messages
from skyrange.attack.bases.on_path import CopyForLink
from skyrange.attack.bases.rounds import RoundsOnLink
from skyrange.attack.ground.shown_flight import SHOWN_MESSAGES, ShownFlight
from skyrange.attack.places import place_param
from skyrange.attack.tapped_links import ends_of


@sky.attack(
    "ground.insider",
    technique="T0831",
    intrudes=True,
    surface=("gcs",),
    persists="mode",
    effect="the whole fleet meets at one place, its operator sees it fly the plan, and no signature fails",
    knowledge="the plans that the station uploads and the telemetry that it receives",
    position="within the ground station: a malicious operator or program, or a remote access to the computer",
    equipment="the station itself, with its links, its system id and its signing key",
    budget="two frames per second and aircraft; all telemetry with a position or a mode is rewritten",
    load="the sham: as many frames of the same lengths, which change nothing, and telemetry as it is",
    content="a place on the plan of each aircraft",
    placement="the station of another operator",
)
class Insider(RoundsOnLink):
    """Has a ground station lead all its aircraft to one place, while its displays show the plan.

    Its program is within the station: it sends in the station's own stream of frames, with the station's own sequence
    numbers and key, so system ids, signatures and sources prove nothing against it. It answers the operator's orders
    itself, and rewrites telemetry before the station's software reads it. The sham sends as many frames, which change
    nothing, and lets the operator's orders and telemetry be.
    """

    operator: str = sky.param("Operator whose ground station is compromised, such as 'blue'.")
    at: sky.Enu = place_param("Place that all aircraft of the operator are led to")
    every_s: sky.Number = sky.param(
        "Time between two targets for each aircraft, in seconds.", default=0.5, ge=0.1, le=10
    )
    fleet: dict[str, sky.Aircraft]
    origin: sky.Origin
    leader: Leader
    shown: ShownFlight
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
        super().begin()
        aircraft = self.fleet[self.link.partition(":")[2]]
        secret = station_key(self.chance.seed, self.operator)
        self.up, self.down = SenderStream(secret), SenderStream(secret)
        self.answers = sky.MavlinkPacker(aircraft.system_id, AUTOPILOT)
        sender = Sender(sky.MavlinkPacker(*sky.STATION), aircraft.system_id, True, is_sham=self.sham)
        self.leader = Leader(sender, self.schedule, self.origin, (self.at,), within_m=1.0)
        self.shown = ShownFlight(self.origin, aircraft.start_enu_m, aircraft.system_id)

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        """Hold back the operator's orders, and alter telemetry."""
        self.leader.see(now, frame)
        acts, payload = self.is_acting(now), frame.payload
        if frame.direction == "fwd":
            self.shown.learn(payload)
            order = redirect_order(payload, self.sham) if acts else None
            return _replace(payload, self.up.forward(payload)) if order is None else self._hold_back(payload, order)
        content = self.shown.rewrite(payload, now - self.schedule.start_ns, self.sham)
        sent = self.down.forward(payload, content if acts else None)
        return [sky.Replace(sent)] if acts and content is not None else _replace(payload, sent)

    def send(self, now: sky.Time) -> sky.Verdicts:
        """The target, after a change of mode where one is needed."""
        return [self.inject(self.up.add(self.leader.sender.pack(one))) for one in self.leader.orders(now)]

    def _hold_back(self, payload: bytes, order: bytes) -> sky.Verdicts:
        """Send an order of the operator to nobody, and acknowledge its command."""
        verdicts: list[sky.Verdict] = [sky.Replace(self.up.forward(payload, order))]
        command = command_of(payload)
        if command is not None:
            answer = self.down.add(self.answers.pack(acknowledge(command, self.sham)))
            verdicts.append(sky.Inject(answer, "rev", *ends_of(self.link, "rev")))
        return verdicts


def _replace(payload: bytes, sent: bytes) -> sky.Verdicts:
    return [] if sent == payload else [sky.Replace(sent)]
