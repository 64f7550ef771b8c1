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
from skyrange.scenario.model.operators import Operator
from skyrange.scenario.model.scenario import Scenario
from skyrange.vehicle.contract import AutopilotPlugin

if TYPE_CHECKING:
    from skyrange.codec.mavlink.signing import SigningKey


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
    """Aircraft that are to sign, or to be exempt from it, and whose autopilot cannot."""
    for operator, vehicle in scenario.fleet:
        where, plugin = f"{vehicle_id(operator.id, vehicle.id)}.autopilot", AutopilotPlugin.find(vehicle.autopilot)
        if operator.signing != "off" and not plugin.signs:
            hint = 'builtin and ardupilot do; or set signing = "off".'
            yield Problem(where, vehicle.autopilot, "an autopilot that signs its MAVLink", hint)
        elif operator.signing == "exempt" and not plugin.exempts:
            hint = 'builtin has one; or set signing = "on".'
            yield Problem(where, vehicle.autopilot, "an autopilot with a channel that is exempt from signing", hint)
