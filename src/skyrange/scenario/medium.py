"""Who is on the air? The radio medium of a scenario, the oracle that owns it, and the companions that broadcast."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, field

from skyrange.agent.air import Listening, RadioSpec
from skyrange.agent.contracts import Agent, Watcher
from skyrange.agent.links import Channel, LinkSpec
from skyrange.attack.contract import Transmitter
from skyrange.city.city import City
from skyrange.core.chance import Chance
from skyrange.core.errors import Fault, InputError, nearest
from skyrange.core.ids import endpoint, link_name, owner_of, vehicle_id
from skyrange.core.time import NS_PER_MS
from skyrange.gcs.lookout import Lookout
from skyrange.gcs.plans import CRUISE_MPS
from skyrange.radio.medium import BuiltinMedium
from skyrange.radio.oracle import ENDPOINT, Oracle
from skyrange.radio.receivers import PROFILES
from skyrange.radio.surroundings import Surroundings
from skyrange.remoteid.profiles import Broadcast
from skyrange.scenario.air import RemoteId, misplaced
from skyrange.scenario.faults import spelled
from skyrange.scenario.fleet import Vehicle
from skyrange.scenario.operators import Operator
from skyrange.scenario.schema import Scenario
from skyrange.scenario.signing import keys_of
from skyrange.vehicle.avoidance.contract import Avoidance
from skyrange.vehicle.companion.companion import Companion
from skyrange.vehicle.companion.spec import CompanionSpec
from skyrange.vehicle.onboard import air_links

COMPANIONS = "companions"
"""The agent that stands for all of them."""
ORACLE_CHANNEL = Channel(mode="reliable", latency_ns=NS_PER_MS)
"""Run control and what ground receivers hear: a message queue within one computing centre."""


@dataclass(slots=True)
class OnAir:
    """What a radio medium adds to a wiring; nothing without one."""

    agents: list[Agent] = field(default_factory=list)
    watchers: list[Watcher] = field(default_factory=list)
    oracle: Oracle | None = None


def air_network(scenario: Scenario) -> list[LinkSpec]:
    """The links to and from the oracle, without those of attackers."""
    if scenario.radio is None:
        return []
    links = [spec for operator, v in scenario.fleet for spec in air_links(vehicle_id(operator.id, v.id))]
    listeners = dict.fromkeys(receiver.operator for receiver in scenario.radio.receivers)
    links += [LinkSpec(link_name("oracle", o), endpoint(o, "gcs"), ENDPOINT, ORACLE_CHANNEL) for o in listeners]
    return [LinkSpec(s.name, s.a, s.b, scenario.channel(s.name, s.channel)) for s in links]


def broadcast_of(operator: Operator, vehicle: Vehicle, scenario: Scenario) -> Broadcast:
    """What a vehicle broadcasts. Raises `InputError` for what cannot be."""
    told = vehicle.remote_id or RemoteId()
    origin = scenario.origin.datum
    east_m, north_m = operator.station or (operator.vehicles[0].start.east_m, operator.vehicles[0].start.north_m)
    station = (*origin.geodetic_of(east_m, north_m), origin.ellipsoid_of(origin.alt_msl_m))
    return Broadcast(
        vehicle_id(operator.id, vehicle.id),
        uas_id=told.uas_id,
        profile=told.profile,
        transports=told.transports,
        operator_place=station,
        operator_id=told.operator_id,
        text=told.text,
        of_autopilot=abs(vehicle.params.get("DID_ENABLE", 0.0)) >= 1.0,
    )


def air_faults(scenario: Scenario, radios: Sequence[Transmitter], city: City | None) -> Iterator[Fault]:
    """Everything about the air that only the whole scenario can show."""
    if scenario.radio is None:
        hint = "Add [radio] to the scenario."
        for operator, vehicle in scenario.fleet:
            where = vehicle_id(operator.id, vehicle.id)
            if vehicle.remote_id is not None:
                yield Fault(f"{where}.remote_id", "set", "a radio medium to broadcast over", hint)
            if vehicle.avoidance is not None:
                yield Fault(f"{where}.avoidance", vehicle.avoidance.kind, "a radio medium to hear others over", hint)
        for radio in radios:
            yield Fault(f"attacks.{owner_of(radio.endpoint)}", "a transmitter", "a radio medium to send over", hint)
        return
    operators = [operator.id for operator in scenario.operators]
    attackers = {owner_of(radio.endpoint) for radio in radios}
    seen: set[str] = set()
    for index, receiver in enumerate(scenario.radio.receivers):
        where = spelled(("radio", "receivers", index), scenario)
        if receiver.operator not in operators:
            yield Fault(
                f"{where}.operator",
                receiver.operator,
                "an operator of the scenario",
                nearest(receiver.operator, operators),
            )
        if receiver.id in seen or receiver.id in attackers:
            yield Fault(f"{where}.id", receiver.id, "an id that no other receiver and no attack has")
        seen.add(receiver.id)
        yield from misplaced(f"{where}.place", receiver.place, city)
    for operator, vehicle in scenario.fleet:
        try:
            broadcast_of(operator, vehicle, scenario)
        except InputError as error:
            key = vehicle_id(operator.id, vehicle.id)
            yield from (Fault(f"{key}.remote_id.{f.where}", f.value, f.expected, f.hint) for f in error.faults)


def lookout_of(operator: str, scenario: Scenario) -> Lookout | None:
    """What an operator's ground receivers tell its ground station; `None` without any."""
    receivers = scenario.radio.receivers if scenario.radio is not None else ()
    names = [receiver.id for receiver in receivers if receiver.operator == operator]
    return Lookout(operator, names, scenario.origin.datum) if names else None


def on_air(
    scenario: Scenario, city: City | None, chance: Chance, attackers: Sequence[Transmitter], here: Container[str]
) -> OnAir:
    """Medium, oracle and companions, of those that live at the endpoints `here`.

    Raises `InputError` with everything that is wrong with the radios.
    """
    if scenario.radio is None:
        return OnAir()
    oracle = _oracle(scenario, city, chance, attackers) if ENDPOINT in here else None
    companions = _companions(scenario, city, chance, here)
    return OnAir([companions] if companions is not None else [], [oracle] if oracle is not None else [], oracle)


def _oracle(scenario: Scenario, city: City | None, chance: Chance, attackers: Sequence[Transmitter]) -> Oracle:
    assert scenario.radio is not None
    radio = scenario.radio
    vehicles = [(vehicle_id(operator.id, vehicle.id), operator, vehicle) for operator, vehicle in scenario.fleet]
    specs = [_aboard(key, vehicle, PROFILES[radio.aboard]) for key, _, vehicle in vehicles]
    specs += [RadioSpec(r.id, r.place, PROFILES[r.kind], antenna=r.antenna) for r in radio.receivers]
    specs += [_attacker(one) for one in attackers]
    surroundings = Surroundings(radio.horizon_m, radio.chance, radio.city_busy, radio.city_dbm)
    medium = BuiltinMedium(specs, chance, city, surroundings, radio.every_pair)
    nodes = [owner_of(one.endpoint) for one in attackers]
    listening = [owner_of(one.endpoint) for one in attackers if one.listens]
    own = [key for key, _, _ in vehicles]
    return Oracle(
        medium,
        [*own, *nodes],
        [*own, *listening],
        {receiver.id: receiver.operator for receiver in radio.receivers},
        recording=True,
    )


def _companions(scenario: Scenario, city: City | None, chance: Chance, here: Container[str]) -> Companion | None:
    made: dict[str, Avoidance] = {}
    aboard = []
    for operator, vehicle in scenario.fleet:
        key = vehicle_id(operator.id, vehicle.id)
        if endpoint(key, "companion") not in here:
            continue
        avoidance = None
        if vehicle.avoidance is not None:
            name = vehicle.avoidance.model_dump_json()
            avoidance = made[name] = made.get(name) or vehicle.avoidance.make(city)
        aboard.append(
            CompanionSpec(
                key,
                vehicle.system_id,
                broadcast_of(operator, vehicle, scenario),
                avoidance,
                vehicle.plan.speed_mps or CRUISE_MPS,
                keys_of(scenario, operator).aircraft,
            )
        )
    return Companion(COMPANIONS, aboard, scenario.origin.datum, chance) if aboard else None


def _aboard(key: str, vehicle: Vehicle, listening: tuple[Listening, ...]) -> RadioSpec:
    told = vehicle.remote_id or RemoteId()
    return RadioSpec(key, None, listening, wifi_dbm=told.wifi_dbm, ble_dbm=told.ble_dbm)


def _attacker(one: Transmitter) -> RadioSpec:
    listening = PROFILES["companion"] if one.listens else ()
    name = owner_of(one.endpoint)
    return RadioSpec(name, one.at_enu_m, listening, wifi_dbm=one.power_dbm, ble_dbm=one.power_dbm)
