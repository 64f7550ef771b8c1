"""Path rules: is each order of defences that does not work named before the run, with one that does?"""

from __future__ import annotations

import pytest

from skyrange.assembly.build import build
from skyrange.contracts.params import Params
from skyrange.core.errors import InputError
from skyrange.defence.contract import Defence, DefenceContext, DefencePlugin
from skyrange.defence.path_rules import PathEnd, Sends
from skyrange.scenario.toml_files import load_text
from tests.registered_kinds import registered

BASE = """
name = "several"
duration_s = 20
origin = [47.3977, 8.5456]
[[operators]]
id = "blue"
SIGNING
  [[operators.vehicles]]
  id = "b1"
  plan = { square = { side_m = 10, alt_m = 8 } }
  [[operators.vehicles]]
  id = "b2"
  start = [40, 0]
  plan = { square = { side_m = 10, alt_m = 8 } }
"""
SIGN = "mavlink.signing"
HASH = "mission.hash"
HASH_PROXY = "mission.hash", 'params = { at = "proxy" }'
READ = "mission.read_back"
WATCH = "parameter.watch"
WATCH_COMPANION = "parameter.watch", 'params = { at = "companion" }'
WALL = "mavlink.firewall"
WALL_PROXY = "mavlink.firewall", 'params = { at = "proxy" }'
WALL_NO_TUNNEL = "mavlink.firewall", 'params = { messages = ["HEARTBEAT", "COMMAND_LONG"] }'
WALL_PROXY_NO_TUNNEL = "mavlink.firewall", 'params = { at = "proxy", messages = ["HEARTBEAT", "COMMAND_LONG"] }'
WALL_NO_RETURN = "mavlink.firewall", 'params = { commands = ["DO_SET_MODE"] }'
Table = str | tuple[str, str]


def scenario(*tables: Table, signing: str = "off") -> str:
    declared = []
    for name, table in zip("ab", tables, strict=False):
        kind, more = table if isinstance(table, tuple) else (table, "")
        declared.append(f'[[defences]]\nid = "{name}"\nkind = "{kind}"\n{more}\n')
    return BASE.replace("SIGNING", f'signing = "{signing}"') + "".join(declared)


def refuse(text: str) -> str:
    with pytest.raises(InputError) as caught:
        build(load_text(text))
    return str(caught.value)


WRONG_ORDERS: list[tuple[Table, Table, str]] = [
    (READ, SIGN, "defences.a: sends COMMAND_LONG, MISSION_ACK, MISSION_REQUEST_INT, MISSION_REQUEST_LIST"),
    (WATCH_COMPANION, SIGN, "defences.a: sends PARAM_REQUEST_READ, PARAM_SET"),
    (HASH_PROXY, SIGN, "defences.a: sends TUNNEL"),
    (HASH, SIGN, "defences.a: holds frames at companion of gcs:blue/b1"),
    (HASH, "mavlink.sequence", "defences.a: holds frames at companion of gcs:blue/b1"),
    (WATCH_COMPANION, WALL, "defences.a: sends PARAM_REQUEST_READ, PARAM_SET, which b drops"),
    (WALL_PROXY, WATCH, "defences.b: sends PARAM_REQUEST_READ, PARAM_SET, which a drops"),
    (WALL_NO_TUNNEL, HASH, "defences.b: sends TUNNEL, which a drops at companion"),
    (HASH_PROXY, WALL_PROXY_NO_TUNNEL, "defences.a: sends TUNNEL, which b drops at proxy of autopilot:blue/b1"),
]


@pytest.mark.parametrize(("one", "other", "problem"), WRONG_ORDERS)
def test_a_wrong_order_is_named_and_the_other_one_works(one: Table, other: Table, problem: str) -> None:
    text = refuse(scenario(one, other))
    assert problem in text
    assert ("Declare a after b." if "defences.a" in problem else "Declare b before a.") in text
    build(load_text(scenario(other, one)))


def test_two_that_wait_for_answers_of_the_same_station_are_refused() -> None:
    for pair in ((HASH, HASH_PROXY), (HASH_PROXY, HASH)):
        assert "decides mission hash of blue/b1" in refuse(scenario(*pair))


REJECTS = 'params = { action = "reject" }'


@pytest.mark.parametrize("kind", ["gnss.barometer", "gnss.innovation"])
def test_a_check_that_takes_fixes_away_is_after_the_one_that_reports_their_loss(kind: str) -> None:
    text = refuse(scenario((kind, REJECTS), "gnss.receiver"))
    assert "defences.b: judges whether there are GNSS fixes of blue/b1, which a takes away" in text
    assert "Declare b before a." in text
    build(load_text(scenario("gnss.receiver", (kind, REJECTS))))
    build(load_text(scenario(kind, "gnss.receiver")))


def test_no_order_of_two_checks_that_take_and_need_fixes_works() -> None:
    assert "Have one of them raise alarms only." in refuse(
        scenario(("gnss.receiver", REJECTS), ("gnss.receiver", REJECTS))
    )


@pytest.mark.parametrize(
    ("one", "other", "problem", "hint"),
    [
        (
            WATCH_COMPANION,
            WALL_PROXY,
            "which b drops at proxy of autopilot:blue/b1",
            "Add PARAM_REQUEST_READ, PARAM_SET",
        ),
        (READ, WALL_NO_TUNNEL, "MISSION_REQUEST_LIST, which b drops", "to the messages of b"),
        (READ, WALL_NO_RETURN, "commands NAV_RETURN_TO_LAUNCH, which b drops", "to the commands of b"),
        (HASH_PROXY, WALL_NO_TUNNEL, "sends TUNNEL, which b drops at companion of gcs:blue/b1", "Add TUNNEL"),
    ],
)
def test_what_no_order_mends_has_another_hint(one: Table, other: Table, problem: str, hint: str) -> None:
    text = refuse(scenario(one, other))
    assert problem in text
    assert hint in text
    assert "Declare" not in text
    assert problem.replace("b drops", "a drops") in refuse(scenario(other, one))


@pytest.mark.parametrize("table", [READ, WATCH, WATCH_COMPANION])
@pytest.mark.parametrize("signing", ["on", "wrong-key"])
def test_frames_that_nobody_signs_are_named_where_operators_sign(table: Table, signing: str) -> None:
    text = refuse(scenario(table, signing=signing))
    assert "unsigned on" in text
    assert "blue signs" in text
    assert 'Set signing = "off"' in text


@pytest.mark.parametrize("table", [HASH, HASH_PROXY, WALL, WALL_PROXY, "mavlink.sequence"])
def test_defences_that_send_nothing_to_the_autopilot_go_with_signing(table: Table) -> None:
    build(load_text(scenario(table, signing="on")))


def test_defences_that_do_not_act_together_are_in_any_order() -> None:
    build(load_text(scenario((READ, "muted = true"), SIGN)))
    build(load_text(scenario((READ, "stop_s = 10"), (SIGN, "start_s = 10"))))
    refuse(scenario((READ, "stop_s = 10.1"), (SIGN, "start_s = 10")))


def test_defences_of_different_aircraft_are_in_any_order() -> None:
    build(
        load_text(
            scenario((READ, 'params = { vehicles = ["blue/b1"] }'), (SIGN, 'params = { vehicles = ["blue/b2"] }'))
        )
    )
    assert "gcs:blue/b2" in refuse(scenario((READ, 'params = { vehicles = ["blue/b2"] }'), SIGN))


class Place(Params):
    """The end of a rule."""

    link: str = ""
    side: str = ""


def _make_stray(params: Place, context: DefenceContext) -> Defence:
    return Defence(path_rules=[Sends(PathEnd(params.link, params.side), "fwd", frozenset((0,)))])


STRAY = DefencePlugin(Place, _make_stray, "Sends from where it is not.")


@pytest.mark.parametrize(("link", "side"), [("gcs:blue/b9", "gcs"), ("gcs:blue/b1", "proxy"), ("x", "gcs")])
def test_a_rule_about_an_end_that_does_not_exist_is_refused(link: str, side: str) -> None:
    with registered(("test.stray", STRAY)):
        text = refuse(scenario(("test.stray", f'params = {{ link = "{link}", side = "{side}" }}')))
    assert f"{side} of {link}" in text
    assert "an end of a gcs, log or autopilot link" in text
