"""Radio of a scenario: the medium, the oracle that owns it, companions that broadcast, and what is wrong with it."""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

from skyrange.assembly.optics import group_sensors, make_landing, make_sight
from skyrange.assembly.remote_id_keys import aircraft_credentials, aircraft_session_id, make_verification
from skyrange.assembly.signing import derive_keys
from skyrange.attack.contract import Transmitter
from skyrange.city.city import City
from skyrange.codec.f3411 import IdType
from skyrange.contracts.components import Agent, TruthSubscriber
from skyrange.contracts.medium import RadioSpec, ScanSchedule
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.files import read_input
from skyrange.core.ids import endpoint, owner_of, vehicle_id
from skyrange.gcs.plan.plans import CRUISE_MPS
from skyrange.gcs.traffic_picture import TrafficPicture
from skyrange.optics.ray_index import index_city
from skyrange.radio.builtin.listening import PROFILES
from skyrange.radio.builtin.params import RadioEnvironment
from skyrange.radio.contract import BUILTIN, MediumContext
from skyrange.radio.oracle import ENDPOINT, Oracle
from skyrange.radio.propagation.loss_table_file import BAND_MHZ, MAX_BYTES, decode_loss_table, read_loss_table
from skyrange.radio.spectrum import Spectrum
from skyrange.remoteid.broadcast_profiles import Broadcast, serial_number
from skyrange.scenario.model.fleet import Vehicle
from skyrange.scenario.model.operators import Operator
from skyrange.scenario.model.radio import Avoidance as AvoidanceTable
from skyrange.scenario.model.radio import RemoteId
from skyrange.scenario.model.scenario import OnDeath, Scenario
from skyrange.scenario.validation.error_messages import spell_path
from skyrange.vehicle.avoidance.contract import Avoidance, AvoidanceContext
from skyrange.vehicle.companion.companion import Companion, CompanionSpec
from skyrange.vehicle.companion.range_reports import RangeReports, SensorCompanion
from skyrange.vehicle.sight.scan_reader import ScanReader

COMPANIONS = "companions"
"""The agent that stands for all of them."""


@dataclass(slots=True)
class BuiltRadio:
    """What a radio medium adds to a wiring; nothing without one."""

    agents: list[Agent] = field(default_factory=list)
    truth_subscribers: list[TruthSubscriber] = field(default_factory=list)
    oracle: Oracle | None = None


class LiveMedium(NamedTuple):
    """What a live range adds to the context of a medium that runs programs; see `MediumContext`."""

    on_death: OnDeath = "stop"
    deadline_s: float = math.inf


def uas_id_of(name: str, vehicle: Vehicle, scenario: Scenario) -> str:
    """The identifier that the vehicle `name` broadcasts: the scenario's, the session id of its DRIP entity tag, or the
    serial number that its name gives.
    """
    remote_id = vehicle.remote_id or RemoteId()
    if remote_id.auth == "drip":
        return aircraft_session_id(name, remote_id, scenario)
    return remote_id.uas_id or serial_number(name)


def make_broadcast(operator: Operator, vehicle: Vehicle, scenario: Scenario) -> Broadcast:
    """What a vehicle broadcasts. Raises `InputError` for what cannot be."""
    remote_id = vehicle.remote_id or RemoteId()
    origin = scenario.origin.datum
    east_m, north_m = operator.station or (operator.vehicles[0].start.east_m, operator.vehicles[0].start.north_m)
    station = (*origin.geodetic_of(east_m, north_m), origin.ellipsoid_of(origin.alt_msl_m))
    name = vehicle_id(operator.id, vehicle.id)
    signs = remote_id.auth == "drip"
    return Broadcast(
        name,
        uas_id=uas_id_of(name, vehicle, scenario) if signs else remote_id.uas_id,
        id_type=IdType.SPECIFIC_SESSION if signs else IdType.SERIAL_NUMBER,
        profile=remote_id.profile,
        transports=remote_id.transports,
        operator_place=station,
        operator_id=remote_id.operator_id,
        text=remote_id.text,
        autopilot_location=abs(vehicle.params.get("DID_ENABLE", 0.0)) >= 1.0,
        credentials=aircraft_credentials(name, remote_id, scenario) if signs else None,
    )


def make_lookout(operator: str, scenario: Scenario) -> TrafficPicture | None:
    """What an operator's ground receivers tell its ground station; `None` without any."""
    receivers = scenario.radio.receivers if scenario.radio is not None else ()
    operator_receivers = [receiver for receiver in receivers if receiver.operator == operator]
    if not operator_receivers:
        return None
    verifications = [make_verification(receiver.verify, scenario) for receiver in operator_receivers]
    return TrafficPicture(
        operator, [receiver.id for receiver in operator_receivers], scenario.origin.datum, verifications, scenario.epoch
    )


def describe_medium(scenario: Scenario, oracle: Oracle | None) -> dict[str, Any]:
    """What the manifest says of the radio: `medium` of one that is not builtin, and `loss_table` if there is one."""
    if scenario.radio is None or oracle is None:
        return {}
    description: dict[str, Any] = {}
    if scenario.radio.plugin is not BUILTIN:
        medium = oracle.medium
        description["medium"] = {"kind": scenario.radio.engine, "repeatable": medium.repeatable, **medium.manifest}
    if scenario.radio.table is not None:
        data = read_input(Path(scenario.radio.table), "loss table", max_bytes=MAX_BYTES)
        header = decode_loss_table(data).header
        description["loss_table"] = {"sha256": sha256(data).hexdigest(), **header.model_dump(mode="json")}
    return description


def build_radio(
    scenario: Scenario,
    city: City | None,
    chance: Chance,
    attackers: Sequence[Transmitter],
    *,
    here: Container[str],
    live: LiveMedium | None = None,
    spectrum: Spectrum | None = None,
    reports: RangeReports | None = None,
) -> BuiltRadio:
    """Medium, oracle and companions, of those that live at the endpoints `here`; `spectrum` is for the oracle to fill.
    `reports` of sensors are the companions' part; without a radio medium they have no other.

    Raises `InputError` with everything that is wrong with the radios.
    """
    if scenario.radio is None:
        return BuiltRadio([] if reports is None else [_make_sensor_companion(scenario, reports)])
    oracle = _oracle(scenario, city, chance, attackers, live or LiveMedium(), spectrum) if ENDPOINT in here else None
    companions = _companions(scenario, city, chance, here, reports)
    return BuiltRadio([companions] if companions is not None else [], [oracle] if oracle is not None else [], oracle)


def _oracle(
    scenario: Scenario,
    city: City | None,
    chance: Chance,
    attackers: Sequence[Transmitter],
    live: LiveMedium,
    spectrum: Spectrum | None,
) -> Oracle:
    assert scenario.radio is not None
    radio = scenario.radio
    vehicles = [(vehicle_id(operator.id, vehicle.id), operator, vehicle) for operator, vehicle in scenario.fleet]
    specs = [_aboard(key, vehicle, PROFILES[radio.aboard]) for key, _, vehicle in vehicles]
    specs += [RadioSpec(r.id, r.place, PROFILES[r.kind], antenna=r.antenna) for r in radio.receivers]
    specs += [_attacker(attacker) for attacker in attackers]
    surroundings = RadioEnvironment(
        radio.horizon_m, radio.chance, radio.city_busy, radio.city_dbm, radio.carrier_sense_dbm
    )
    table = read_loss_table(Path(radio.table)).table if radio.table is not None else None
    context = MediumContext(
        specs, chance, city, surroundings, radio.losses, radio.every_pair, loss_table=table, **live._asdict()
    )
    medium = radio.plugin(radio.settings, context)
    nodes = [owner_of(attacker.endpoint) for attacker in attackers]
    listening = [owner_of(attacker.endpoint) for attacker in attackers if attacker.listens]
    vehicle_ids = [key for key, _, _ in vehicles]
    return Oracle(
        medium,
        [*vehicle_ids, *nodes],
        [*vehicle_ids, *listening],
        {receiver.id: receiver.operator for receiver in radio.receivers},
        recording=True,
        spectrum=spectrum,
    )


def _make_sensor_companion(scenario: Scenario, reports: RangeReports) -> SensorCompanion:
    keys = {vehicle_id(o.id, v.id): derive_keys(scenario, o).aircraft for o, v in scenario.fleet}
    scans = ScanReader(group_sensors(scenario))
    return SensorCompanion(COMPANIONS, reports, scans, [keys[vehicle] for vehicle in reports.vehicles])


def _companions(
    scenario: Scenario, city: City | None, chance: Chance, here: Container[str], reports: RangeReports | None
) -> Companion | None:
    made: dict[str, Avoidance] = {}
    aboard = []
    for operator, vehicle in scenario.fleet:
        key = vehicle_id(operator.id, vehicle.id)
        if endpoint(key, "companion") not in here:
            continue
        avoidance = None
        if vehicle.avoidance is not None:
            name = vehicle.avoidance.model_dump_json()
            avoidance = made[name] = made.get(name) or _avoidance(vehicle.avoidance, city)
        aboard.append(
            CompanionSpec(
                key,
                vehicle.system_id,
                make_broadcast(operator, vehicle, scenario),
                avoidance,
                vehicle.plan.speed_mps or CRUISE_MPS,
                derive_keys(scenario, operator).aircraft,
                make_verification((vehicle.remote_id or RemoteId()).verify, scenario),
                *make_sight(key, vehicle),
                make_landing(key, vehicle),
            )
        )
    if not aboard:
        return None
    sees = any(spec.sight is not None for spec in aboard)
    surfaces = index_city(city) if sees else None
    return Companion(COMPANIONS, aboard, scenario.origin.datum, chance, surfaces, reports)


def _avoidance(table: AvoidanceTable, city: City | None) -> Avoidance:
    return table.plugin(table.settings, AvoidanceContext(city))


def _aboard(key: str, vehicle: Vehicle, listening: tuple[ScanSchedule, ...]) -> RadioSpec:
    remote_id = vehicle.remote_id or RemoteId()
    return RadioSpec(key, None, listening, wifi_dbm=remote_id.wifi_dbm, ble_dbm=remote_id.ble_dbm)


def _attacker(transmitter: Transmitter) -> RadioSpec:
    listening = PROFILES["companion"] if transmitter.listens else ()
    name = owner_of(transmitter.endpoint)
    return RadioSpec(
        name, transmitter.at_enu_m, listening, wifi_dbm=transmitter.power_dbm, ble_dbm=transmitter.power_dbm
    )


def check_radios(scenario: Scenario, radios: Sequence[Transmitter], city: City | None) -> Iterator[Problem]:
    """Everything about the air that only the whole scenario can show."""
    if scenario.radio is None:
        hint = "Add [radio] to the scenario."
        for operator, vehicle in scenario.fleet:
            where = vehicle_id(operator.id, vehicle.id)
            if vehicle.remote_id is not None:
                yield Problem(f"{where}.remote_id", "set", "a radio medium to broadcast over", hint)
            if vehicle.avoidance is not None:
                yield Problem(f"{where}.avoidance", vehicle.avoidance.kind, "a radio medium to hear others over", hint)
            if vehicle.landing is not None:
                yield Problem(
                    f"{where}.landing",
                    vehicle.landing.kind,
                    "a radio medium, without which aircraft have no companion",
                    hint,
                )
        for radio in radios:
            yield Problem(f"attacks.{owner_of(radio.endpoint)}", "a transmitter", "a radio medium to send over", hint)
        return
    if scenario.radio.losses == "engine" and scenario.radio.plugin is BUILTIN:
        hint = 'Leave it out, or set an engine that is another program, such as engine = "ns3".'
        yield Problem("radio.losses", "engine", "city: the builtin medium has no losses of its own", hint)
    if scenario.radio.table is not None:
        yield from check_loss_table(scenario.radio.table, city)
    operators = [operator.id for operator in scenario.operators]
    attackers = {owner_of(radio.endpoint) for radio in radios}
    seen: set[str] = set()
    for index, receiver in enumerate(scenario.radio.receivers):
        where = spell_path(("radio", "receivers", index), scenario)
        if receiver.operator not in operators:
            yield Problem(
                f"{where}.operator",
                receiver.operator,
                "an operator of the scenario",
                nearest(receiver.operator, operators),
            )
        if receiver.id in seen or receiver.id in attackers:
            yield Problem(f"{where}.id", receiver.id, "an id that no other receiver and no attack has")
        seen.add(receiver.id)
        yield from check_place(f"{where}.place", receiver.place, city)
    for operator, vehicle in scenario.fleet:
        try:
            make_broadcast(operator, vehicle, scenario)
        except InputError as error:
            key = vehicle_id(operator.id, vehicle.id)
            yield from (Problem(f"{key}.remote_id.{f.where}", f.value, f.expected, f.hint) for f in error.problems)


def check_place(where: str, place: tuple[float, float, float], city: City | None) -> Iterator[Problem]:
    """Antennas below the ground or inside buildings; `where` is the place's key."""
    east_m, north_m, up_m = place
    shown = f"[{east_m:g}, {north_m:g}, {up_m:g}] m"
    building = city.inside(east_m, north_m, up_m) if city is not None else None
    if up_m < 0.0:
        yield Problem(where, shown, "a place on the ground (0) or above")
    elif building is not None:
        yield Problem(
            where,
            shown,
            f"a place outside buildings; this is in {building.name or building.id}, {building.height_m:g} m high",
            "Put it on the roof, or into the street.",
        )


def check_loss_table(file: str, city: City | None) -> Iterator[Problem]:
    """A loss table that cannot be read, of another city, or of another band; `file` is its name."""
    where = "radio.table"
    try:
        header = read_loss_table(Path(file)).header
    except InputError as error:
        yield from (Problem(where, f.value, f.expected, f.hint) for f in error.problems)
        return
    hint = "Make one of this city: `skyrange radio map`."
    if city is None:
        yield Problem(where, file, "a scenario with buildings, because the table was made of some")
    elif header.buildings != city.digest():
        value = f"{file} of buildings with SHA-256 {header.buildings[:16]}…"
        yield Problem(where, value, f"a table of this scenario's buildings, SHA-256 {city.digest()[:16]}…", hint)
    if not BAND_MHZ[0] <= header.frequency_mhz <= BAND_MHZ[1]:
        band = f"a table of {BAND_MHZ[0]:g} to {BAND_MHZ[1]:g} MHz"
        yield Problem(where, f"{file} of {header.frequency_mhz:g} MHz", band, hint)
