"""Defences in a live range: their parts are in several processes, and their alarms are in the one record."""

from __future__ import annotations

from pathlib import Path

import pytest

from skyrange.attack.tapped_links import TapMaker
from skyrange.contracts.plugins.registry import NoParams
from skyrange.core.errors import InputError
from skyrange.defence.contract import Defence, DefenceContext, DefencePlugin
from skyrange.defence.placement import DefenceTap, place_taps
from skyrange.runtime.live.range import prepare_range
from skyrange.scenario.toml_files import load_text
from tests.integration.live_programs import live
from tests.ports import OFFSET
from tests.registered_kinds import registered

SCENARIO = """
name = "defended"
seed = 3
duration_s = 22
origin = [47.3977, 8.5456]
[radio]
[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  plan = { square = { side_m = 20, alt_m = 8 } }
  [[operators.vehicles]]
  id = "b2"
  start = [60, 0]
  plan = { square = { side_m = 20, alt_m = 8 } }
[[attacks]]
id = "terminate"
kind = "mavlink.command"
start_s = 16
params = { vehicles = ["blue/b1"], command = "DO_FLIGHTTERMINATION", values = [1] }
[[attacks]]
id = "jump"
kind = "gnss.jump"
start_s = 17
params = { vehicles = ["blue/b2"], offset_m = [40, 0, 0] }
[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
start_s = 14
params = { at = [60, 150, 30], velocity_mps = [-3, -2, 0], transmitter_m = [-140, 40, 2] }
[[defences]]
id = "signing"
kind = "mavlink.signing"
[[defences]]
id = "hash"
kind = "mission.hash"
params = { at = "proxy" }
[[defences]]
id = "watch"
kind = "parameter.watch"
[[defences]]
id = "innovation"
kind = "gnss.innovation"
[[defences]]
id = "appearance"
kind = "remote_id.appearance"
"""
ALARMS = {
    ("signing", "signing.unsigned", "blue/b1"),
    ("innovation", "innovation.fix", "blue/b2"),
    ("appearance", "remote_id.appearance", "blue/b1"),
    ("appearance", "remote_id.appearance", "blue/b2"),
}


@pytest.mark.realtime
def test_alarms_of_all_processes_are_in_the_record(tmp_path: Path) -> None:
    with live(tmp_path, SCENARIO, OFFSET, "--group", "component") as flight:
        _, record = flight.landed()
    assert {(row["detector"], row["kind"], row["subject"]) for row in record.table("alerts").to_pylist()} == ALARMS
    events = record.table("events").to_pylist()
    starts = [row["about"] for row in events if row["kind"] == "event.defence_start"]
    assert sorted(starts) == ["appearance", "hash", "innovation", "signing", "watch"]
    assert sum(row["kind"] == "event.takeoff" for row in events) == 2
    assert not any(row["kind"] == "event.crash" for row in events)
    frames = {frame.id: frame for frame in record.frames_with_payloads()}
    forged = {row["frame"] for row in record.table("labels").to_pylist() if row["attack"] == "terminate"}
    assert {frames[one].fate for one in forged} == {"dropped"}


def make_pair(params: NoParams, context: DefenceContext) -> Defence:
    """Taps at both ends of a link that say that they share state."""
    vehicles = list(context.vehicles)
    maker = TapMaker(DefenceTap)
    taps = [tap for side in ("gcs", "companion") for tap in place_taps("gcs", side, vehicles, context, maker)]
    return Defence(taps=taps, one_process=True)


ONE_PROCESS = DefencePlugin(NoParams, make_pair, "Has parts that share state.")
UNDEFENDED = SCENARIO.partition("[[attacks]]")[0]


def test_parts_that_share_state_in_two_processes_are_named(tmp_path: Path) -> None:
    with registered(("test.one_process", ONE_PROCESS)):
        scenario = load_text(f'{UNDEFENDED}[[defences]]\nid = "both"\nkind = "test.one_process"\n')
        with pytest.raises(InputError, match=r"defences\.both: parts in the processes blue.*--group one"):
            prepare_range(scenario, tmp_path / "two", group="component")
        prepare_range(scenario, tmp_path / "operator", group="operator")  # station and companions in one process
        prepare_range(scenario, tmp_path / "one", group="one")


@pytest.mark.parametrize("kind", ["mavlink.signing", "mission.hash", "mission.read_back"])
def test_a_part_at_a_station_outside_is_named(kind: str, tmp_path: Path) -> None:
    text = f'{UNDEFENDED}[[defences]]\nid = "d"\nkind = "{kind}"\n'
    with pytest.raises(InputError, match=r"defences\.d: a part at blue\.gcs, a component outside the range"):
        prepare_range(load_text(text), tmp_path / "run", outside=("blue.gcs",))
    prepare_range(load_text(f"{text}muted = true\n"), tmp_path / "muted", outside=("blue.gcs",))


def test_a_defence_at_the_companion_goes_with_a_station_outside(tmp_path: Path) -> None:
    text = f'{UNDEFENDED}[[defences]]\nid = "d"\nkind = "mavlink.firewall"\n'
    prepare_range(load_text(text), tmp_path / "run", outside=("blue.gcs",))
