"""Checks of the radios of a whole scenario: places, names, and whether there is a medium to send over."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from skyrange.assembly.radio import make_broadcast
from skyrange.attack.contract import Transmitter
from skyrange.city.city import City
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.ids import owner_of, vehicle_id
from skyrange.radio.contract import BUILTIN
from skyrange.radio.propagation.loss_table_file import BAND_MHZ, read_loss_table
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.validation.error_messages import spell_path


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
