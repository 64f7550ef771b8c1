"""Are attacks declared, checked and written as the rest of a scenario is?"""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest

from skyrange.assembly.build import build
from skyrange.attack.campaign import StagedAdversary
from skyrange.attack.campaigns.parts import Controller
from skyrange.attack.contract import AttackPlugin
from skyrange.attack.triggers import Near
from skyrange.contracts.plugins import registry as plugins
from skyrange.core.errors import InputError
from skyrange.core.time import NEVER, NS_PER_S
from skyrange.scenario.model.scenario import Scenario, json_schema
from skyrange.scenario.toml_files import load_text, to_toml
from tests.hostile_kind import offered

JAM = AttackPlugin.find("remote_id.jam")
SPOOF = AttackPlugin.find("remote_id.spoof")
REPLAY = AttackPlugin.find("remote_id.replay")

FLEET = """
name = "s"
origin = [40.778, -73.955]
[radio]
[[operators]]
id = "green"
  [[operators.vehicles]]
  id = "g1"
  plan.square = { side_m = 20, alt_m = 10 }
"""
GHOST = """
[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
start_s = 3
for_s = 9.5
when = { vehicle = "green/g1", within_m = 30, of = [0, 0, 10] }
params = { at = [10, 10, 10], form = "swarm", count = 5, transports = ["bt4", "wifi_beacon"] }
"""


@pytest.fixture(autouse=True)
def _kinds(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The shipped kinds and the tests' own, whatever is installed."""
    monkeypatch.setattr(plugins, "_registered", dict(plugins._registered))
    for kind, made in (("remote_id.spoof", SPOOF), ("remote_id.replay", REPLAY), ("remote_id.jam", JAM)):
        plugins.register(plugins.ATTACKS, kind, made)
    with offered():
        yield


def loaded(text: str) -> Scenario:
    return load_text(FLEET + text)


def faults(text: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        build(loaded(text))
    return [str(fault) for fault in caught.value.problems]


def test_what_is_declared_is_wired() -> None:
    built = build(loaded(GHOST))
    (plan,) = built.wiring.acts
    assert (plan.id, plan.start_ns, plan.stop_ns, plan.lasts_ns) == ("ghost", 3 * NS_PER_S, NEVER, 9_500_000_000)
    assert plan.trigger is not None
    assert list(plan.trigger.vehicles) == ["green/g1"]
    assert [agent.name for agent in plan.agents] == ["ghost.radio"]
    assert "rid_up:ghost" in {spec.name for spec in built.wiring.links}
    (row,) = built.header["attacks"]
    assert row["radios"] == [{"endpoint": "ghost.radio", "at_enu_m": [10.0, 10.0, 2.0]}]
    assert (row["kind"], row["touches"], row["technique"]) == ("remote_id.spoof", ["rid_up:ghost", "medium"], "T0856")
    json.dumps(built.header)


def test_it_reads_back_as_it_was_written() -> None:
    other = '[[attacks]]\nid="home"\nkind="test.homeward"\nmuted=true\nsham=true\nstop_s=4\nparams.vehicle="green/g1"\n'
    scenario = loaded(GHOST + other)
    again = load_text(to_toml(scenario))
    assert again == scenario
    assert again.attacks[0].params["rate_hz"] == 1.0, "every value that a run used"
    assert loaded("").attacks == ()
    assert "attacks" not in to_toml(loaded(""))


def test_overrides_reach_attacks_by_id() -> None:
    text = FLEET + GHOST
    scenario = load_text(text, overrides=["attacks.ghost.muted=true", "attacks.*.params.count=9"])
    assert scenario.attacks[0].muted
    assert scenario.attacks[0].params["count"] == 9


def test_all_that_is_wrong_is_said_at_once() -> None:
    found = faults(
        """
        [[attacks]]
        id = "one"
        kind = "remote_id.spof"
        [[attacks]]
        id = "one"
        kind = "remote_id.spoof"
        when = { vehicle = "green/g1", within_m = -1, of = [0, 0] }
        params = { at = [10, 10], form = "swrm", count = "5", transprts = ["bt4"] }
        [[attacks]]
        id = "three"
        kind = "remote_id.spoof"
        start_s = 9
        stop_s = 8
        params = { at = [1, 2, 3], form = "position" }
        """
    )
    text = "\n".join(found)
    for words in (
        "attacks.one.id: one — expected an id that no other attack has",
        "attacks.one.kind: remote_id.spof — expected a kind of attack that is installed. Did you mean 'remote_id.sp",
        "attacks.one.when.within_m: -1 — expected more than 0",
        "attacks.one.when.of: [0, 0] — expected a place",
        "attacks.one.params.at.2: missing",
        "Did you mean 'swarm'?",
        "attacks.one.params.count: '5' — expected a whole number",
        "transprts = ['bt4'] — expected a known key. Did you mean 'transports'?",
        "attacks.three.stop_s: 8 — expected more than start_s, 9",
        "attacks.three.params.vehicle: missing",
    ):
        assert words in text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('when = { vehicle = "green/g2", within_m = 3, of = [0,0,0] }\nparams.at = [1,2,3]', "when.vehicle: green/g2"),
        ('when = { vehicle = "green/g1", within_m = 3, of = "red/r1" }\nparams.at = [1,2,3]', "when.of: red/r1"),
        ('params = { at=[1,2,3], form="position", vehicle="green/g9" }', "Did you mean 'green/g1'?"),
        ('params = { at=[1,2,3], via="link", on="green/g9" }', "params.on: green/g9"),
        ("params = { at=[1,2,3], via='radio', on='green/g1' }", "no aircraft with via = 'radio'"),
        ("params = { at=[1,2,3], uas_id='x', form='swarm' }", "params.uas_id"),
        ("params = { at=[1,2,nan] }", "params.at.2"),
    ],
)
def test_what_does_not_fit_the_scenario_is_named(text: str, words: str) -> None:
    (found,) = faults(f'[[attacks]]\nid = "a"\nkind = "remote_id.spoof"\n{text}\n')
    assert found.startswith("attacks.a.")
    assert words in found


def test_an_attack_on_a_link_that_is_not_there_is_named() -> None:
    (found,) = faults('[[attacks]]\nid="a"\nkind="test.homeward"\nparams.vehicle="green/g9"\n')
    assert "attacks.a.params.vehicle: green/g9" in found


def test_a_radio_inside_a_building_is_named() -> None:
    # blocks of 72 m between streets of 24 m stand about the origin: (48, 48) is inside the block north-east of it
    city = "[city]\ngrid = {}\n"
    jam = '[[attacks]]\nid="j"\nkind="remote_id.jam"\nparams.transmitter_m=[{}, {}, 2]\n'
    text = FLEET.replace("[[operators]]", city + "[[operators]]", 1)
    built = build(load_text(text))
    assert built.city is not None
    place = built.city.buildings[0].shape.representative_point()
    with pytest.raises(InputError, match=r"attacks\.j\.params\.transmitter_m.*a place outside buildings"):
        build(load_text(text + jam.format(place.x, place.y)))
    build(load_text(text + jam.format(0, 0)))


CAMPAIGN = """
[[attacks]]
id = "mallory"
kind = "campaign"
{anchor}
[attacks.params]
taps = ["gcs:green/g1"]
receiver_m = [{x}, {y}, 2]
acts.ghost = {{ kind = "remote_id.spoof", params = {{ at = [{x}, {y}, 20], transmitter_m = [{x}, {y}, 3] }} }}
acts.pull = {{ kind = "gnss.capture", params = {{ at = [{x}, {y}, 9], transmitter_m = [{x}, {y}, 5] }} }}
acts.lead = {{ kind = "mavlink.home", params = {{ vehicles = ["green/g1"], at = [{x}, {y}, 0] }} }}
[[attacks.params.stages]]
name = "see"
until = {{ sighting = {{ vehicle = "green/g1", place = [{x}, {y}, 8], within_m = 5 }} }}
timeout_s = 9
[[attacks.params.stages]]
name = "act"
acts = ["ghost", "pull", "lead"]
timeout_s = 5
"""


def test_places_in_acts_of_a_campaign_count_from_its_anchor() -> None:
    fleet = FLEET.replace('id = "g1"', 'id = "g1"\n  start = [100, -20]')
    anchored = build(load_text(fleet + CAMPAIGN.format(anchor='anchor = "green/g1"', x=1, y=2)))
    placed = build(load_text(fleet + CAMPAIGN.format(anchor="", x=101, y=-18)))
    (row,), (other,) = anchored.header["attacks"], placed.header["attacks"]
    assert row["shown"] == other["shown"]
    assert row["radios"] == other["radios"]
    assert len(row["radios"]) == 2
    (one,), (two,) = anchored.wiring.acts, placed.wiring.acts
    assert isinstance(one.agents[0], Controller)
    assert isinstance(two.agents[0], Controller)
    mine, others = one.agents[0].course.adversary, two.agents[0].course.adversary
    assert isinstance(mine, StagedAdversary)
    assert isinstance(others, StagedAdversary)
    assert mine.stages == others.stages
    wrong = CAMPAIGN.replace("mavlink.home", "mavlink.hoem").format(anchor='anchor = "green/g1"', x=1, y=2)
    with pytest.raises(InputError, match=r"acts\.lead\.kind: mavlink.hoem"):
        build(load_text(fleet + wrong))


def test_places_count_from_an_anchor() -> None:
    moved = FLEET.replace('id = "g1"', 'id = "g1"\n  start = [100, -20]')
    anchored = GHOST.replace("params = {", 'anchor = "green/g1"\nparams = {')
    built = build(load_text(moved + anchored))
    (row,) = built.header["attacks"]
    assert row["radios"] == [{"endpoint": "ghost.radio", "at_enu_m": [110.0, -10.0, 2.0]}]
    assert len(row["shown"]) == 5
    for east_m, north_m, up_m in row["shown"].values():
        assert (east_m - 110.0) ** 2 + (north_m + 10.0) ** 2 <= 100.0**2
        assert up_m == 10.0
    trigger = built.wiring.acts[0].trigger
    assert isinstance(trigger, Near)
    assert trigger.place_enu_m == (100.0, -20.0, 10.0)
    with pytest.raises(InputError, match=r"anchor: green/g9 .* Did you mean 'green/g1'"):
        load_text(moved + anchored.replace('anchor = "green/g1"', 'anchor = "green/g9"'))


def test_a_transmitter_that_is_not_placed_stands_on_the_roof() -> None:
    city = "[city]\ngrid = {}\n"
    built = build(load_text(FLEET.replace("[radio]", city + "[radio]") + GHOST.replace("[10, 10, 10]", "[30, 30, 70]")))
    assert built.city is not None
    roof_m = built.city.height_at(30.0, 30.0)
    assert roof_m > 0
    assert built.header["attacks"][0]["radios"][0]["at_enu_m"] == [30.0, 30.0, roof_m + 2.0]


def test_the_schema_knows_each_kinds_parameters() -> None:
    schema = json_schema()
    attack = schema["$defs"]["AttackTable"]
    assert "remote_id.spoof" in attack["properties"]["kind"]["examples"]
    by_kind = {part["if"]["properties"]["kind"]["const"]: part["then"] for part in attack["allOf"]}
    name = by_kind["remote_id.spoof"]["properties"]["params"]["$ref"].rpartition("/")[2]
    properties = schema["$defs"][name]["properties"]
    assert properties["rate_hz"]["maximum"] == 10
    assert all(value["description"] for value in properties.values())
