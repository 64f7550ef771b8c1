"""Do the defences of receivers of Remote ID keep their contract, each under an attack that it notices?"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

import pytest

from skyrange.core.errors import InputError
from skyrange.scenario.model.radio import Radio, Receiver, RemoteId
from skyrange.scenario.model.scenario import Scenario
from skyrange.testing import check_defence
from skyrange.testing.checks.attacks import two_squares

pytestmark = pytest.mark.rotating

PLACES = {"west": (-60.0, 0.0, 4.0), "east": (120.0, 40.0, 4.0), "north": (0.0, 150.0, 4.0)}


def squares_on_air(duration_s: float) -> Scenario:
    """Two aircraft with Remote ID and three ground receivers of blue's."""
    receivers = tuple(Receiver(id=name, operator="blue", place=place) for name, place in PLACES.items())
    return two_squares(duration_s).model_copy(update={"radio": Radio(receivers=receivers)})


def signed_squares(duration_s: float) -> Scenario:
    """The same, and both aircraft sign their Remote ID."""
    scenario, signs = squares_on_air(duration_s), {"remote_id": RemoteId(auth="drip")}
    operators = [
        one.model_copy(update={"vehicles": tuple(vehicle.model_copy(update=signs) for vehicle in one.vehicles)})
        for one in scenario.operators
    ]
    return scenario.model_copy(update={"operators": tuple(operators)})


def _spoof(start_s: float, **params: Any) -> dict[str, Any]:
    return {"kind": "remote_id.spoof", "start_s": start_s, "params": params}


APPROACH = _spoof(2.0, at=[0, 260, 8], velocity_mps=[0, -20, 0], transmitter_m=[20, 5, 2], rate_hz=4)
SECOND = _spoof(6.0, form="position", vehicle="green/g1", at=[0, 200, 8])
HOVER = _spoof(16.0, at=[0, 60, 20])
ECHO = {"kind": "remote_id.replay", "start_s": 4.0, "params": {"transmitter_m": [20, 20, 2], "delay_s": 4.0}}
KINDS: list[tuple[str, Mapping[str, Any], float, Mapping[str, Any], Collection[str]]] = [
    ("remote_id.signal", {}, 16.0, APPROACH, ("drop",)),
    ("remote_id.motion", {}, 10.0, SECOND, ("drop",)),
    ("remote_id.replay", {}, 12.0, ECHO, ("drop",)),
    ("remote_id.appearance", {}, 20.0, HOVER, ("drop",)),
    ("remote_id.ground", {}, 16.0, APPROACH, ("drop", "replace")),
]


@pytest.mark.catalogue
@pytest.mark.parametrize(("name", "params", "duration_s", "attack", "acts"), KINDS, ids=[kind[0] for kind in KINDS])
def test_shipped_defences_conform(
    name: str, params: Mapping[str, Any], duration_s: float, attack: Mapping[str, Any], acts: Collection[str]
) -> None:
    check_defence(name, params, attack, scenario=squares_on_air, duration_s=duration_s, acts=acts)


@pytest.mark.catalogue
@pytest.mark.parametrize("attack", [HOVER | {"start_s": 2.0}, ECHO], ids=["unsigned", "old"])
def test_verification_of_signatures_conforms(attack: Mapping[str, Any]) -> None:
    """Drops are nominal: a sender is not believed before its first signature."""
    params = {"authorities": "all"}
    check_defence("remote_id.drip", params, attack, scenario=signed_squares, duration_s=20.0, acts=False)


def test_signatures_are_verified_where_somebody_signs_and_only_once() -> None:
    def refused(params: Mapping[str, Any], scenario: Callable[[float], Scenario]) -> str:
        with pytest.raises(InputError) as caught:
            check_defence("remote_id.drip", params, HOVER, scenario=scenario, duration_s=2.0)
        return str(caught.value)

    assert "radio" in refused({}, two_squares)
    assert "policy: ignore-unsigned — expected an aircraft that signs" in refused({}, squares_on_air)
    assert "clock_error_s" in refused({"clock_error_s": 121}, signed_squares)


def test_without_a_medium_there_is_nothing_to_defend() -> None:
    with pytest.raises(InputError, match="radio"):
        check_defence("remote_id.signal", {}, HOVER, scenario=two_squares, duration_s=2.0)


def test_without_ground_receivers_nothing_can_agree() -> None:
    def no_receivers(duration_s: float) -> Scenario:
        return two_squares(duration_s).model_copy(update={"radio": Radio()})

    with pytest.raises(InputError, match="receivers"):
        check_defence("remote_id.ground", {}, HOVER, scenario=no_receivers, duration_s=2.0)
