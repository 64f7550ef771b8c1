"""Attacks and faults of a scenario made: agents, taps, links, radios, sensor faults, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from fnmatch import fnmatchcase
from functools import partial
from typing import Any

from skyrange.assembly.acts.conflicts import Acting, find_exclusions, find_sensorless, find_unread, window_of
from skyrange.assembly.acts.honest_arm import HonestAircraft, aircraft_of, carried, find_claim_problems, is_honest
from skyrange.assembly.control_links import describe_to_attackers
from skyrange.assembly.optics import group_sensors
from skyrange.assembly.radio import check_place, uas_id_of
from skyrange.assembly.remote_id_keys import AdversaryKeys, find_anchors
from skyrange.attack.contract import (
    Aircraft,
    Attack,
    AttackContext,
    AttackPlugin,
    GroundReceiver,
    Place,
    Transmitter,
    move_place,
    move_places,
    moved,
)
from skyrange.attack.techniques import choose_technique
from skyrange.city.city import City
from skyrange.contracts.links import Act, LinkSpec, Schedule, TapPlacement
from skyrange.contracts.params import Params
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.ids import owner_of, vehicle_id
from skyrange.core.time import NEVER, from_seconds
from skyrange.scenario.model.attacks import ActTable, AttackTable, FaultTable
from skyrange.scenario.model.scenario import Scenario


@dataclass(slots=True)
class MadeAttacks:
    """All attacks and faults of a scenario, made: what is added to its wiring, its medium and its manifest."""

    plans: list[Act] = field(default_factory=list)
    taps: list[TapPlacement] = field(default_factory=list)
    links: list[LinkSpec] = field(default_factory=list)
    radios: list[Transmitter] = field(default_factory=list)
    rows: list[dict[str, Any]] = field(default_factory=list)
    """What the manifest says of each attack."""
    fault_rows: list[dict[str, Any]] = field(default_factory=list)
    """What it says of each fault."""
    problems: list[Problem] = field(default_factory=list)
    aircraft: list[HonestAircraft] = field(default_factory=list)
    """The real aircraft of honest arms."""
    exclusive: list[Acting] = field(default_factory=list)
    """What those that are not muted alter as the only ones."""


def make_attack_context(scenario: Scenario, links: Sequence[LinkSpec], city: City | None) -> AttackContext:
    """What attacks and faults are told; the id, schedule and sham of each are its own."""
    vehicles = {}
    for operator, vehicle in scenario.fleet:
        key, start = vehicle_id(operator.id, vehicle.id), vehicle.start
        vehicles[key] = Aircraft(
            (start.east_m, start.north_m, 0.0), uas_id_of(key, vehicle, scenario), vehicle.system_id
        )
    receivers = scenario.radio.receivers if scenario.radio is not None else ()
    return AttackContext(
        id="",
        vehicles=vehicles,
        links=[spec.name for spec in links],
        origin=scenario.origin.datum,
        epoch=scenario.epoch,
        chance=Chance(scenario.seed),
        duration_ns=from_seconds(scenario.duration_s),
        schedule=Schedule(),
        city=city,
        over_air=describe_to_attackers(links),
        receivers={receiver.id: GroundReceiver(receiver.operator, receiver.place) for receiver in receivers},
        sensors=group_sensors(scenario),
        signed=[operator.id for operator in scenario.operators if operator.signing != "off"],
        keys=AdversaryKeys(scenario),
        anchors=partial(find_anchors, scenario),
    )


def make_attacks(scenario: Scenario, context: AttackContext, own_sensors: Sequence[str]) -> MadeAttacks:
    """Make every attack and every fault; what is wrong with them is in `problems`.

    `context` is that of all of them; id, schedule and sham are filled in for each. `own_sensors` are vehicles that do
    not fly by the range's sensors.
    """
    made = MadeAttacks()
    for attack in scenario.acts:
        is_fault = isinstance(attack, FaultTable)
        own_context = replace(
            context, id=attack.id, schedule=Schedule(), sham=_is_sham(attack), honest=is_honest(attack)
        )
        where = f"{'faults' if is_fault else 'attacks'}.{attack.id}"
        try:
            made_attack = attack.plugin(_anchored(attack, context), own_context)
        except InputError as error:
            made.problems += [Problem(f"{where}.params.{f.where}", f.value, f.expected, f.hint) for f in error.problems]
            continue
        if made_attack.body_hooks and not is_fault:
            made.problems.append(Problem(where, "parts that act on bodies", "a fault: no attack acts on bodies"))
            continue
        if (
            isinstance(attack, AttackTable)
            and attack.plugin.from_start
            and (attack.start_s > 0 or attack.when is not None or attack.manual)
        ):
            value = "a start by hand" if attack.manual else "a trigger" if attack.when else f"{attack.start_s:g}"
            expected = f"0 without a trigger or a start by hand: {attack.kind} alters what is loaded at the start"
            made.problems.append(Problem(f"{where}.start_s", value, expected))
        made.problems += find_unread(made_attack.sensor_hooks, own_sensors, f"{where}.params.vehicles")
        made.problems += find_sensorless(made_attack.scan_hooks, scenario, f"{where}.params")
        names = [*context.links, *(spec.name for spec in made_attack.links)]
        for tap in made_attack.taps:
            if not any(fnmatchcase(name, tap.match) for name in names):
                hint = nearest(tap.match, names)
                made.problems.append(Problem(f"{where}.params", tap.match, "a link of the scenario", hint))
        if not attack.muted:
            window = window_of(attack, context.duration_ns, scenario.manual_acts)
            made.exclusive.append((where, window, made_attack.exclusive))
        made.plans.append(_plan(attack, made_attack, own_context.schedule, _anchor(attack, context)))
        made.taps += [replace(tap, attack=attack.id) for tap in made_attack.taps]
        made.links += made_attack.links
        if isinstance(attack, AttackTable) and attack.honest:
            made.problems += find_claim_problems(where, attack, made_attack, scenario, context.city)
            made.aircraft += aircraft_of(attack, made_attack, own_context.schedule)
        made.radios += carried(made_attack.radios, made_attack.claims) if own_context.honest else made_attack.radios
        (made.fault_rows if is_fault else made.rows).append(_row(attack, made_attack))
    made.problems += find_exclusions(made.exclusive)
    return made


def _is_sham(attack: ActTable) -> bool:
    return isinstance(attack, AttackTable) and attack.sham


def _anchor(attack: ActTable, context: AttackContext) -> Place:
    """Where its places count from."""
    return (0.0, 0.0, 0.0) if attack.anchor is None else context.vehicles[attack.anchor].start_enu_m


def _anchored(attack: ActTable, context: AttackContext) -> Params:
    """Its parameters with places in metres from the origin."""
    settings, plugin = attack.settings, attack.plugin
    if attack.anchor is None:
        return settings
    by = _anchor(attack, context)
    return moved(plugin, settings, by) if isinstance(plugin, AttackPlugin) else move_places(plugin.places, settings, by)


def _plan(attack: ActTable, made: Attack, schedule: Schedule, anchor: Place) -> Act:
    trigger = attack.when.trigger if attack.when is not None else None
    if trigger is not None and trigger.place_enu_m is not None:
        trigger = replace(trigger, place_enu_m=move_place(trigger.place_enu_m, anchor))
    return Act(
        attack.id,
        start_ns=from_seconds(attack.start_s),
        stop_ns=NEVER if attack.stop_s is None else from_seconds(attack.stop_s),
        muted=attack.muted,
        sham=_is_sham(attack),
        honest=is_honest(attack),
        role="fault" if isinstance(attack, FaultTable) else "attack",
        intrudes=isinstance(attack, AttackTable) and attack.plugin.intrudes,
        agents=made.agents,
        sensor_hooks=made.sensor_hooks,
        body_hooks=made.body_hooks,
        scan_hooks=made.scan_hooks,
        trigger=trigger,
        one_process=made.one_process,
        lasts_ns=NEVER if attack.for_s is None else from_seconds(attack.for_s),
        schedule=schedule,
        manual=attack.manual,
    )


def _row(attack: ActTable, made: Attack) -> dict[str, Any]:
    """An attack or a fault in the manifest: as declared, and what it touches."""
    touches = [tap.match for tap in made.taps] + [spec.name for spec in made.links]
    touches += ["medium"] if made.radios else []
    touches += [f"sensors of {vehicle}" for fault in made.sensor_hooks for vehicle in fault.vehicles]
    touches += [f"scans of {vehicle}" for hook in made.scan_hooks for vehicle in hook.vehicles]
    touches += [f"body of {vehicle}" for fault in made.body_hooks for vehicle in fault.vehicles]
    return {
        **attack.model_dump(exclude_none=True, mode="json"),
        "touches": touches,
        **(_adversary(attack, made) if isinstance(attack, AttackTable) else {}),
        "shown": {name: list(place) for name, place in made.shown.items()},
    }


def _adversary(attack: AttackTable, made: Attack) -> dict[str, Any]:
    """What the manifest says of an attack alone."""
    threat = made.threat or attack.plugin.threat
    sites = dict.fromkeys(tap.site for tap in made.taps if tap.site is not None)
    places = {tap.match: tap.place for tap in made.taps if tap.place is not None}
    return {
        "technique": choose_technique(
            attack.plugin.technique, vars(attack.plugin.params.model_validate(attack.params))
        ),
        "persists": attack.plugin.persists,
        **({"family": attack.plugin.family} if attack.plugin.family else {}),
        "threat": asdict(threat) if threat is not None else {},
        "radios": [
            *({"endpoint": radio.endpoint, "at_enu_m": list(radio.at_enu_m or ())} for radio in made.radios),
            *({"endpoint": site.name, "at_enu_m": list(site.at_enu_m)} for site in sites),
        ],
        **({"places": places} if places else {}),
    }


def check_transmitters(made: MadeAttacks, city: City | None) -> Iterator[Problem]:
    """Attackers' radios where none can be."""
    for radio in made.radios:
        if radio.at_enu_m is not None:
            yield from check_place(f"attacks.{owner_of(radio.endpoint)}.params.transmitter_m", radio.at_enu_m, city)
    for site in dict.fromkeys(tap.site for tap in made.taps if tap.site is not None):
        yield from check_place(f"attacks.{owner_of(site.name)}.params.radio_m", site.at_enu_m, city)
