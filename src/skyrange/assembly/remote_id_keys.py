"""DRIP keys of a scenario: the registry of the range, keys of aircraft, and what receivers verify with.

Keys follow from the seed: they are a model and protect nothing real. Imports are late, because they are slow and most
scenarios sign nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from skyrange.core.ids import vehicle_id
from skyrange.scenario.model.radio import RemoteId, Verify
from skyrange.scenario.model.scenario import Scenario

if TYPE_CHECKING:
    from skyrange.remoteid.drip.registry import Anchor, Registration, Registry
    from skyrange.remoteid.drip.sender import Credentials
    from skyrange.remoteid.drip.verification.verdicts import Verification

BEFORE_S: Final = 3600
"""Endorsements are valid from so long before simulated time 0…"""
AFTER_S: Final = 86_400
"""… to so long after the end of the run."""
_REGISTRIES: Final = {"range": "registry", "unknown": "unknown registry"}


def make_registry(scenario: Scenario, name: str = "range") -> Registry:
    """A registry of the range, by its name in the scenario."""
    from skyrange.codec.drip import since_2019_s
    from skyrange.remoteid.drip.registry import Registry

    start_s = int(since_2019_s(scenario.epoch.unix_ns))
    until_s = start_s + math.ceil(scenario.duration_s) + AFTER_S
    return Registry.of_seed(scenario.seed, start_s - BEFORE_S, until_s, name=_REGISTRIES[name])


def aircraft_credentials(vehicle: str, remote_id: RemoteId, scenario: Scenario) -> Credentials:
    """What an aircraft with `auth = "drip"` signs with."""
    from skyrange.remoteid.drip.sender import RECOMMENDED, REQUIRED, Credentials

    registration = make_registry(scenario, remote_id.registry).register(vehicle)
    rates = REQUIRED if remote_id.auth_rates == "required" else RECOMMENDED
    return Credentials(registration, rates, scenario.seed, remote_id.auth_repeats)


def aircraft_session_id(vehicle: str, remote_id: RemoteId, scenario: Scenario) -> str:
    """The UAS ID of such an aircraft, as `BasicId.uas_id` has it."""
    from skyrange.codec.drip import session_id

    return session_id(aircraft_credentials(vehicle, remote_id, scenario).registration.identity.tag)


def find_anchors(scenario: Scenario, authorities: str) -> tuple[Anchor, ...]:
    """The public keys that a receiver holds before the flight, by `authorities` of its settings."""
    registry = make_registry(scenario)
    return registry.anchors if authorities == "apex" else registry.known


def make_verification(verify: Verify | None, scenario: Scenario) -> Verification | None:
    """How a receiver verifies; `None` if it does not."""
    if verify is None:
        return None
    from skyrange.remoteid.drip.verification.verdicts import Verification

    anchors = find_anchors(scenario, verify.authorities)
    return Verification.of(anchors, verify.policy, verify.clock_error_s, verify.verifications_per_s)


@dataclass(frozen=True, slots=True)
class AdversaryKeys:
    """The keys that adversaries of a scenario can hold (`skyrange.attack.contract.RemoteIdKeys`)."""

    scenario: Scenario

    def registered(self, name: str) -> Registration:
        """A registration in the registry of the range; no aircraft has it, because their names have a slash."""
        return make_registry(self.scenario).register(name)

    def unregistered(self, name: str) -> Registration:
        """A registration in the registry that no receiver knows."""
        return make_registry(self.scenario, "unknown").register(name)

    def stolen(self, vehicle: str) -> Registration | None:
        """The registration of an aircraft; `None` if it signs nothing or does not exist."""
        for operator, aircraft in self.scenario.fleet:
            remote_id = aircraft.remote_id
            if vehicle_id(operator.id, aircraft.id) == vehicle and remote_id is not None and remote_id.auth == "drip":
                return aircraft_credentials(vehicle, remote_id, self.scenario).registration
        return None
