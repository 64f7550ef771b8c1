"""MAVLink signing keys of a scenario: a model of pairing. Keys follow from the scenario and protect nothing real."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

from skyrange.core.errors import Problem
from skyrange.core.ids import vehicle_id
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
    if operator.signing == "on":
        return Keys(aircraft, aircraft)
    return Keys(aircraft, SigningKey(secret_from_passphrase(f"{phrase}/wrong"), initial))


def check_signing(scenario: Scenario) -> Iterator[Problem]:
    """Aircraft that are to sign and whose autopilot cannot."""
    for operator, vehicle in scenario.fleet:
        if operator.signing != "off" and not AutopilotPlugin.find(vehicle.autopilot).signs:
            where = f"{vehicle_id(operator.id, vehicle.id)}.autopilot"
            hint = 'builtin and ardupilot do; or set signing = "off".'
            yield Problem(where, vehicle.autopilot, "an autopilot that signs its MAVLink", hint)
