"""Can a scenario name what the radio and Remote ID have, and nothing else?"""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import pytest

from skyrange.assembly.build import build
from skyrange.assembly.radio import make_broadcast
from skyrange.core.errors import InputError
from skyrange.radio.builtin.listening import PROFILES
from skyrange.remoteid.broadcast_profiles import TRANSPORTS
from skyrange.scenario.model.radio import Radio, Receiver, ReceiverKind, RemoteId
from skyrange.scenario.toml_files import load_data, load_text, to_toml


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


@pytest.mark.parametrize(
    ("radio", "where", "hint"),
    [
        ({"engine": "NS3"}, "radio.engine", "'ns3'"),
        ({"engine": "ns3", "params": {"error_modell": "nist"}}, "radio.params.error_modell", "'error_model'"),
        ({"engine": "ns3", "params": {"error_model": "nits"}}, "radio.params.error_model", "'nist'"),
        ({"engine": "ns3", "params": {"preamble_rssi_dbm": 900}}, "radio.params.preamble_rssi_dbm", "at most 60"),
        ({"engine": "ns3", "params": {"preamble_detection": 1}}, "radio.params.preamble_detection", "true or false"),
        ({"engine": "ns3", "params": {"deadline_s": 0}}, "radio.params.deadline_s", "more than 0"),
        ({"engine": "ns3", "params": {"path_loss": "friss"}}, "radio.params.path_loss", "'friis'"),
        ({"engine": "ns3", "params": 5}, "radio.params", "a table"),
        ({"params": {"error_model": "nist"}}, "radio.params.error_model", "known key"),
        ({"engine": "ns3", "losses": "ns3"}, "radio.losses", "'city' or 'engine'"),
    ],
)
def test_mistakes_in_an_engine_are_told_with_their_key(radio: dict[str, Any], where: str, hint: str) -> None:
    given = {"name": "air", "duration_s": 1, "origin": {"lat": 40.0, "lon": -74.0}, "radio": radio, "operators": []}
    with pytest.raises(InputError) as caught:
        load_data(given)
    problem = next(one for one in caught.value.problems if one.where.startswith("radio"))
    assert problem.where == where
    assert hint in f"{problem.expected} {problem.hint}"


def test_the_builtin_medium_has_no_losses_of_its_own() -> None:
    plan = {"path": {"points": [[0, 10]], "alt_m": 5}}
    given: dict[str, Any] = {
        "name": "air",
        "duration_s": 1,
        "origin": {"lat": 40.0, "lon": -74.0},
        "operators": [{"id": "op", "vehicles": [{"id": "a1", "plan": plan}]}],
    }
    with pytest.raises(InputError, match=r"radio\.losses"):
        build(load_data(given | {"radio": {"losses": "engine"}}))
    build(load_data(given | {"radio": {"losses": "city"}})).close()


def test_an_engine_and_its_parameters_are_written_as_they_were_read() -> None:
    plan = {"path": {"points": [[0, 10]], "alt_m": 5}}
    given = {
        "name": "air",
        "duration_s": 1,
        "origin": {"lat": 40.0, "lon": -74.0},
        "radio": {"engine": "ns3", "losses": "engine", "params": {"error_model": "nist", "capture_margin_db": 5.0}},
        "operators": [{"id": "op", "vehicles": [{"id": "a1", "plan": plan}]}],
    }
    scenario = load_data(given)
    again = load_text(to_toml(scenario), "again", Path())
    assert again.radio == scenario.radio
    assert again.radio is not None
    assert (again.radio.params["error_model"], again.radio.params["capture_margin_db"]) == ("nist", 5.0)
