"""Flights under attackers at places in the network: whose frames arrive without an association, and what is read."""

from __future__ import annotations

import copy
from collections import Counter
from pathlib import Path

import pytest

from skyrange.assembly.build import build
from skyrange.kernel import Kernel
from skyrange.metrics.time_series import read_notes
from skyrange.record import RunRecord
from skyrange.record.write.memory_observer import MemoryObserver
from skyrange.scenario import Scenario
from skyrange.study.runs import fly

pytestmark = pytest.mark.rotating

RADIO = 'place = "air", radio_m = [40, 5, 2], has_key = true'
PLACES = {"air": RADIO, "network": 'place = "network"', "onboard": 'place = "onboard"'}
DEAUTHENTICATION = """
[[attacks]]
id = "deauth"
kind = "control_link.deauthenticate"
start_s = 3
params = { transmitter_m = [35.0, 5.0, 2.0] }
"""


def attacked(kind: str, params: str, *, wifi: str = "", more: str = "", duration_s: float = 6.0) -> Scenario:
    """An aircraft near its access point, on the ground, under an attack from 4 s on."""
    return Scenario.from_toml(f"""
name = "reach"
duration_s = {duration_s}
origin = [40.0, -73.0]
[radio]
[[links]]
match = "gcs:*"
channel = "wifi"
wifi = {{ {wifi} }}
[[operators]]
id = "blue"
station = [0, 0]
  [[operators.vehicles]]
  id = "b1"
  start = [30, 0]
  plan = {{ square = {{ side_m = 8, alt_m = 6 }} }}
[[attacks]]
id = "x"
kind = "{kind}"
start_s = 4
params = {{ {params} }}
{more}""")


def command(place: str) -> str:
    return f'vehicles = ["blue/b1"], command = "REQUEST_MESSAGE", times = 0, every_s = 0.05, {place}'


def fates(record: RunRecord) -> Counter[str]:
    """What became of the attacker's frames on the control link, those at the end of the run left out."""
    return Counter(
        row["fate"]
        for batch in record.batches("frames", ["link", "sender", "fate"])
        for row in batch.to_pylist()
        if row["sender"].startswith("x@") and row["link"] == "gcs:blue/b1" and row["fate"] != "in_flight"
    )


@pytest.mark.parametrize("place", list(PLACES))
def test_without_an_association_commands_arrive_from_on_board_alone(place: str, tmp_path: Path) -> None:
    free = fly(attacked("mavlink.command", command(PLACES[place])), tmp_path / "free", report=False)
    assert set(fates(free)) == {"delivered"}
    cut = attacked("mavlink.command", command(PLACES[place]), more=DEAUTHENTICATION)
    record = fly(cut, tmp_path / "cut", report=False)
    assert set(fates(record)) == {"delivered" if place == "onboard" else "lost"}
    assert fates(record).total() > 30
    row = record.manifest["attacks"][0]
    assert row["places"] == {"gcs:blue/b1": place}
    labels = [label for label in record.table("labels").to_pylist() if label["attack"] == "x"]
    assert {(label["action"], label["benign"]) for label in labels} == {("inject", False)}
    assert len(labels) >= fates(record).total(), "what is lost has its label, too"


def test_a_listener_reads_a_link_in_the_air_if_it_is_near_and_can_decrypt(tmp_path: Path) -> None:
    learnt = {}
    for name, wifi, place in (
        ("clear", "encrypted = false", "radio_m = [40, 5, 2]"),
        ("far", "encrypted = false", "radio_m = [9000, 5, 2]"),
        ("encrypted", "", "radio_m = [40, 5, 2]"),
        ("key", "", "radio_m = [40, 5, 2], has_key = true"),
    ):
        scenario = attacked("link.eavesdrop", f'links = ["gcs:*"], place = "air", {place}', wifi=wifi)
        record = fly(scenario, tmp_path / name, report=False)
        learnt[name] = sum(note.kind == "event.learned" for note in read_notes(record, "events"))
    assert learnt["far"] == learnt["encrypted"] == 0
    assert learnt["clear"] > 3
    assert learnt["key"] > 3


def test_an_attacker_in_the_air_takes_the_answers_of_the_aircraft_from_it(tmp_path: Path) -> None:
    """An upload goes on where the aircraft is heard to ask for the next item."""
    params = f'vehicles = ["blue/b1"], track = [[20, 0, 6], [20, 20, 6]], restart = false, {RADIO}'
    record = fly(attacked("mavlink.mission_replace", params, duration_s=8.0), tmp_path / "run", report=False)
    assert fates(record)["delivered"] >= 5  # the count, and four items with home and the end


def test_a_fork_under_an_attacker_in_the_air_continues_as_the_run_does() -> None:
    scenario = attacked("mavlink.exfiltrate", f'vehicles = ["blue/b1"], {RADIO}', duration_s=6.0)
    stem_sees = MemoryObserver()
    stem = Kernel(build(scenario).wiring, [stem_sees])
    stem.advance(4_200_000_000)
    fork_sees = copy.deepcopy(stem_sees)
    fork = stem.fork([fork_sees])
    fork.advance(6_000_000_000)
    stem.advance(6_000_000_000)
    rows = [sorted((f.sent_ns, f.id, f.fate, f.arrived_ns) for f in one.frames) for one in (stem_sees, fork_sees)]
    assert rows[0] == rows[1]
    assert any(row[1].sender.startswith("x@") for row in rows[0])
