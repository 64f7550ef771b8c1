"""Can a scenario name what the radio and Remote ID have, and nothing else?"""

from __future__ import annotations

from typing import get_args

import pytest

from skyrange.assembly.radio import make_broadcast
from skyrange.core.errors import InputError
from skyrange.radio.builtin.listening import PROFILES
from skyrange.remoteid.broadcast_profiles import TRANSPORTS
from skyrange.scenario.model.radio import Radio, Receiver, ReceiverKind, RemoteId
from skyrange.scenario.toml_reader import load_data


def test_every_kind_of_receiver_can_be_named_but_none() -> None:
    """A receiver that hears nothing is left out instead."""
    assert set(get_args(ReceiverKind)) == PROFILES.keys() - {"none"}
    with pytest.raises(InputError, match="sniffer"):
        Radio(aboard="none")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="sniffer"):
        Receiver(id="mast", operator="blue", place=(0, 0, 2), kind="none")  # type: ignore[arg-type]


@pytest.mark.parametrize("name", TRANSPORTS)
def test_every_transport_can_be_named_once(name: str) -> None:
    assert RemoteId(transports=(name,)).transports == (name,)
    with pytest.raises(InputError, match="each transport once"):
        RemoteId(transports=(name, name))


def test_bluetooth_is_both_kinds_and_others_are_unknown() -> None:
    with pytest.raises(InputError, match="each transport once"):
        RemoteId(transports=("bluetooth", "bt5"))
    with pytest.raises(InputError, match="wifi_nan"):
        RemoteId(transports=("wifi_nann",))


@pytest.mark.parametrize(
    ("own", "shared", "then"), [(None, None, False), (1, None, True), (None, 1, True), (0, 1, False)]
)
def test_did_enable_makes_the_companion_the_autopilots_transmitter(
    own: float | None, shared: float | None, then: bool
) -> None:
    """For one aircraft or all of an operator's."""
    params = [{} if value is None else {"DID_ENABLE": value} for value in (own, shared)]
    plan = {"path": {"points": [[0, 10]], "alt_m": 5}}
    scenario = load_data(
        {
            "name": "did",
            "duration_s": 1,
            "origin": {"lat": 40.0, "lon": -74.0},
            "radio": {},
            "operators": [
                {"id": "op", "params": params[1], "vehicles": [{"id": "a1", "plan": plan, "params": params[0]}]}
            ],
        }
    )
    (operator,) = scenario.operators
    assert make_broadcast(operator, operator.vehicles[0], scenario).autopilot_location is then
