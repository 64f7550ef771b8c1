"""MAVLink signing in a scenario: keys, as after pairing, and gateways.

Keys follow from the scenario and protect nothing real.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from skyrange.contracts.components import Tap
from skyrange.contracts.links import TapPlacement
from skyrange.core.errors import Problem
from skyrange.core.ids import link_name, vehicle_id
from skyrange.core.time import NS_PER_S
from skyrange.scenario.model.operators import Operator
from skyrange.scenario.model.scenario import Scenario
from skyrange.vehicle.contract import AutopilotPlugin

if TYPE_CHECKING:
    from skyrange.codec.mavlink.signing import SigningKey, SigningTime


class Keys(NamedTuple):
    """What each side of an operator's network was paired with; None: it neither signs nor checks."""

    aircraft: SigningKey | None
    station: SigningKey | None


def derive_keys(scenario: Scenario, operator: Operator) -> Keys:
    """The keys of an operator of a scenario. With a wrong key, its ground station has that of another passphrase."""
    from skyrange.codec.mavlink.signing import (  # slow to import, and mostly off
        SigningKey,
        range_passphrase,
        secret_from_passphrase,
        signing_timestamp,
    )

    if operator.signing == "off":
        return Keys(None, None)
    phrase, initial = range_passphrase(scenario.seed, operator.id), signing_timestamp(scenario.epoch.unix_ns)
    aircraft = SigningKey(secret_from_passphrase(phrase), initial)
    if operator.signing == "gateway":
        return Keys(aircraft, None)
    if operator.signing != "wrong-key":
        return Keys(aircraft, aircraft)
    return Keys(aircraft, SigningKey(secret_from_passphrase(f"{phrase}/wrong"), initial))


def derive_stored_key(scenario: Scenario, operator: Operator) -> SigningKey | None:
    """The key of an operator's aircraft with the timestamp with which they start.

    If they stored it before the run, it is the stored one and a minute (GCS_Signing.cpp `load_signing_key`).
    """
    key, rules = derive_keys(scenario, operator).aircraft, operator.signing_time
    if key is None or rules is None or rules.saved_ago_s is None:
        return key
    from skyrange.codec.mavlink.signing import MAX_LAG, UNIT_NS

    saved = key.initial - round(rules.saved_ago_s * NS_PER_S) // UNIT_NS
    return key._replace(initial=max(saved, 0) + MAX_LAG)


def read_signing_time(operator: Operator, *, station: bool = False) -> SigningTime:
    """By what the timestamps of an operator's aircraft advance, or those of its ground station."""
    from skyrange.codec.mavlink.signing import SIGNING_TIME, ClockRule, SigningTime

    rules = operator.signing_time
    if rules is None:
        return SIGNING_TIME
    if station:
        return SigningTime(follows=rules.station == "received")
    return SigningTime(ClockRule(rules.aircraft))


@dataclass(frozen=True, slots=True)
class _MakeGateway:
    """Makes the tap of a gateway, for a link's name; a class, because taps are made again in copies."""

    key: SigningKey

    def __call__(self, link: str) -> Tap:
        from skyrange.vehicle.signing_gateway import SigningGateway

        return SigningGateway(self.key)


def place_gateways(scenario: Scenario) -> list[TapPlacement]:
    """The gateways that sign for aircraft, at their ends of the links `gcs`."""
    placed = []
    for operator, vehicle in scenario.fleet:
        key = derive_keys(scenario, operator).aircraft if operator.signing == "gateway" else None
        if key is not None:
            link = link_name("gcs", vehicle_id(operator.id, vehicle.id))
            placed.append(TapPlacement(link, "companion", _MakeGateway(key)))
    return placed


def check_signing(scenario: Scenario) -> Iterator[Problem]:
    """Aircraft that are to sign, or to be exempt, and whose autopilot cannot; rules of time that nobody obeys."""
    for operator in scenario.operators:
        if operator.signing_time is not None and operator.signing == "off":
            yield Problem(f"{operator.id}.signing_time", "a table", "none, because signing is off")
    for operator, vehicle in scenario.fleet:
        where, plugin = f"{vehicle_id(operator.id, vehicle.id)}.autopilot", AutopilotPlugin.find(vehicle.autopilot)
        if operator.signing != "off" and not plugin.signs:
            hint = 'builtin and ardupilot do; or set signing = "off".'
            yield Problem(where, vehicle.autopilot, "an autopilot that signs its MAVLink", hint)
        elif vehicle.autopilot != "builtin" and _rules_aircraft(operator):
            hint = "An ArduPilot has rules of its own (RTC_TYPES); signing_time.station applies to all."
            expected = "builtin, because the operator has signing_time.aircraft or signing_time.saved_ago_s"
            yield Problem(where, vehicle.autopilot, expected, hint)
        elif operator.signing == "exempt" and not plugin.exempts:
            hint = 'builtin has one; or set signing = "on".'
            yield Problem(where, vehicle.autopilot, "an autopilot with a channel that is exempt from signing", hint)


def _rules_aircraft(operator: Operator) -> bool:
    """Whether an operator says anything about the time of its aircraft's signatures."""
    rules = operator.signing_time
    return rules is not None and (rules.aircraft != "every-fix" or rules.saved_ago_s is not None)
