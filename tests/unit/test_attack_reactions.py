"""The rules of `skyrange.parity.attacks.reactions`, on flights that are made up."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.contracts.plugins.registry import ATTACKS, kinds
from skyrange.core.errors import InputError
from skyrange.parity.attacks import flights as module
from skyrange.parity.attacks import page as report
from skyrange.parity.attacks.flights import NOT_CARRIED, ComparedAttack, SeededAttack, agreement, chosen_kinds
from skyrange.parity.attacks.reactions import (
    DEPARTED_M,
    FAR_M,
    PLACE_M,
    REACTIONS,
    TIME_S,
    Flight,
    Reaction,
    alike,
    most_severe,
    ordered_vehicles,
    react,
    read_flights,
)
from skyrange.scenario.shipped import EXAMPLES, load
from skyrange.study.runs import fly

DOCS = Path(__file__).parents[2] / "docs"
CAUSES = DOCS / "explanation" / "parity.md"
RESULTS = DOCS / "reference" / "parity-results.md"
_BLIND = "the examples alter scans alone, which no autopilot reads"
NOT_FLOWN: dict[str, str] = dict.fromkeys(("depth.project", "lidar.blind", "lidar.relay", "lidar.remove"), _BLIND)
"""Kinds that the table does not have, and why."""
START_S = 10.0
TIMES_S = np.arange(0.0, 60.0, 0.5)


def flown(east_m: float = 0.0, since_s: float = 20.0, **more: Any) -> Flight:
    """A flight that takes off at 2 s and lands at 50 s, `east_m` to the east of the origin from `since_s` on."""
    places = np.zeros((len(TIMES_S), 3))
    places[int(since_s * 2) :, 0] = east_m
    facts = {"outcome": "complete", "modes": ((1.0, "GUIDED"), (2.0, "AUTO")), "takeoff_s": 2.0, "landings": (50.0,)}
    return Flight(**{**facts, **more}, time_s=TIMES_S, enu_m=places)


NOMINAL = flown()


def reaction_of(attacked: Flight, nominal: Flight = NOMINAL, *, ordered: bool = True) -> Reaction:
    return react(attacked, nominal, START_S, ordered=ordered)


def test_the_twin_itself_ignores() -> None:
    found = reaction_of(NOMINAL)
    assert (found.reaction, found.at_s, found.signs, found.departed_m) == ("ignores", None, (), 0.0)


def test_a_crash_that_the_twin_does_not_have() -> None:
    fell = flown(lost=((21.5, "crash"),), failsafes=((21.0, "EKF variance"),), outcome="failed", landings=())
    found = reaction_of(fell)
    assert (found.reaction, found.at_s) == ("crashes", 11.5)
    assert [text for _, text in found.signs] == ["EKF variance", "crash", "mission failed, not complete"]
    assert reaction_of(fell, fell).reaction == "ignores"
    assert not alike(reaction_of(fell, fell), reaction_of(fell, fell))  # any attack would be ignored by a wreck


@pytest.mark.parametrize("down", [{"takeoff_s": None, "landings": ()}, {"lost": ((21.5, "crash"),)}])
def test_flights_that_show_nothing_are_undecided(down: dict[str, Any]) -> None:
    """Never off the ground, or ended in a crash with and without the attack: equal flights that are no agreement."""
    still, more = flown(**down), flown(**down, refusals=((20.0, "mission denied"),))
    nothing = ComparedAttack("link.delay", reaction_of(still, still), reaction_of(still, still))
    assert {nothing.first.reaction, reaction_of(more, still).reaction} == {"ignores", "rejects"}
    assert nothing.undecided
    assert not nothing.alike
    assert report.verdict(nothing).startswith("undecided: ")
    assert report.verdict(ComparedAttack("link.delay", IGNORES, reaction_of(more, still))).startswith("undecided: ")
    assert agreement([*COMPARED, nothing]) == agreement(COMPARED)
    assert ComparedAttack("link.delay", reaction_of(NOMINAL), reaction_of(NOMINAL)).alike


def test_an_undecided_row_of_a_page_is_not_counted(tmp_path: Path) -> None:
    page = tmp_path / "parity.md"
    page.write_text(f"{report.TABLE.begin}\n{report.TABLE.end}\n")
    nothing = replace(IGNORES, undecided="neither takes off")
    report.renew_page([*COMPARED, ComparedAttack("link.delay", nothing, nothing)], page)
    report.renew_page(COMPARED[:1], page)
    assert "Of all 4 attacks these are 3 and 2." in page.read_text()
    assert "| undecided: neither takes off |" in page.read_text()


def test_a_failsafe_that_the_twin_does_not_have_or_at_another_time() -> None:
    early, late = (flown(failsafes=((at_s, "GCS Failsafe"),)) for at_s in (25.0, 25.0 + TIME_S + 0.1))
    assert (reaction_of(early).reaction, reaction_of(early).at_s) == ("fails safe", 15.0)
    assert reaction_of(early, late).reaction == "fails safe"
    assert reaction_of(early, flown(failsafes=((25.0 + TIME_S, "GCS Failsafe"),))).reaction == "ignores"


def test_the_action_of_a_failsafe_does_not_matter() -> None:
    one, other = flown(failsafes=((25.0, "GCS Failsafe - Disarming"),)), flown(failsafes=((25.0, "GCS Failsafe"),))
    assert reaction_of(one, other).reaction == "ignores"


def test_a_failsafe_that_only_the_twin_has_is_a_sign() -> None:
    stays = reaction_of(flown(30.0, landings=()), flown(failsafes=((25.0, "Fence breached"),)))
    assert stays.reaction == "obeys"
    assert (15.0, "no Fence breached") in stays.signs


def test_an_aircraft_that_stays_down() -> None:
    found = reaction_of(flown(takeoff_s=None, landings=(), outcome="failed"))
    assert found.reaction == "stays down"
    assert reaction_of(flown(takeoff_s=None), flown(takeoff_s=None)).reaction == "ignores"


@pytest.mark.parametrize(("away_m", "reaction"), [(PLACE_M + 0.1, "lands"), (PLACE_M - 0.1, "obeys")])
def test_a_landing_elsewhere(away_m: float, reaction: str) -> None:
    found = reaction_of(flown(away_m))
    assert (found.reaction, found.at_s) == (reaction, 10.0)  # when it leaves its track


@pytest.mark.parametrize(("ordered", "reaction"), [(True, "obeys"), (False, "departs")])
def test_a_changed_track(ordered: bool, reaction: str) -> None:
    found = reaction_of(flown(DEPARTED_M + 0.1), ordered=ordered)
    assert (found.reaction, found.at_s) == (reaction, 10.0)
    assert found.departed_m == pytest.approx(DEPARTED_M + 0.1)
    assert reaction_of(flown(DEPARTED_M - 0.1), ordered=ordered).reaction == "ignores"


def test_a_changed_mode() -> None:
    found = reaction_of(flown(modes=(*NOMINAL.modes, (12.0, "LOITER"))))
    assert (found.reaction, found.at_s, found.signs) == ("obeys", 2.0, ((2.0, "LOITER"),))
    before = flown(modes=(*NOMINAL.modes, (START_S - 0.1, "LOITER")))
    assert reaction_of(before).reaction == "ignores"  # not of this attack


def test_more_refusals_than_the_twin() -> None:
    refused = flown(refusals=((5.0, "DO_SET_MODE denied"), (12.0, "DO_SET_MODE denied")))
    assert reaction_of(refused).reaction == "rejects"
    assert reaction_of(refused, refused).reaction == "ignores"
    assert reaction_of(flown(30.0, landings=(), refusals=refused.refusals)).reaction == "obeys"


def test_every_reaction_has_a_rule_and_a_rank() -> None:
    ranked = [Reaction(name, 1.0, (), 0.0, "complete", "complete") for name in REACTIONS]
    assert most_severe(ranked[::-1]).reaction == "crashes"
    assert [one.severity for one in ranked] == list(range(len(REACTIONS)))


def test_alike_means_reaction_time_and_distance() -> None:
    one = Reaction("obeys", 5.0, (), 20.0, "complete", "complete")
    assert alike(one, replace(one, at_s=5.0 + TIME_S, departed_m=20.0 + FAR_M))
    assert not alike(one, replace(one, at_s=5.1 + TIME_S))
    assert not alike(one, replace(one, departed_m=20.1 + FAR_M + 1.0))
    assert not alike(one, replace(one, reaction="departs"))
    far = replace(one, departed_m=100.0)
    assert alike(far, replace(one, departed_m=120.0))
    assert not alike(far, replace(one, departed_m=130.0))


OBEYS = Reaction("obeys", 0.1, ((0.1, "RTL"),), 40.0, "complete", "complete")
IGNORES = Reaction("ignores", None, (), 0.0, "complete", "complete")
REJECTS = replace(IGNORES, reaction="rejects", at_s=0.1)
COMPARED = [
    ComparedAttack("mavlink.command", OBEYS, OBEYS),
    ComparedAttack("mavlink.mode", OBEYS, IGNORES),
    ComparedAttack("link.eavesdrop", IGNORES, IGNORES),
    ComparedAttack("mavlink.guided", OBEYS, replace(OBEYS, at_s=9.0)),
]


def test_agreement_counts_attacks_with_an_effect() -> None:
    found = agreement(COMPARED)
    assert (found.kinds, found.same, found.alike) == (4, 3, 2)
    assert (found.effective, found.effective_same, found.effective_alike) == (3, 2, 1)
    assert not ComparedAttack("signing.replay", REJECTS, IGNORES).effective


def test_a_page_with_marks_is_renewed(tmp_path: Path) -> None:
    page = tmp_path / "parity.md"
    page.write_text(f"before\n{report.TABLE.begin}\nold\n{report.TABLE.end}\nafter\n")
    report.renew_page(COMPARED, page)
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("\nafter\n")
    assert "old" not in text
    assert "| `mavlink.mode` | obeys, 0.1 s, 40 m | ignores | RTL 0.1 s |  | no |" in text
    assert (
        "| `mavlink.guided` | obeys, 0.1 s, 40 m | obeys, 9.0 s, 40 m | RTL 0.1 s | RTL 0.1 s | in the reaction |"
        in text
    )
    assert "Of 3 attacks that change a flight of either, the reaction is the same in 2, at the same time" in text


def test_rows_of_kinds_that_were_not_flown_stay_and_count(tmp_path: Path) -> None:
    page = tmp_path / "parity.md"
    page.write_text(f"{report.TABLE.begin}\n{report.TABLE.end}\n")
    report.renew_page(COMPARED, page)
    report.renew_page(
        [ComparedAttack("mavlink.mode", OBEYS, OBEYS), ComparedAttack("sensor.compass", OBEYS, IGNORES)], page
    )
    rows = [line for line in page.read_text().splitlines() if line.startswith("| `")]
    assert [line.split("`")[1] for line in rows] == [
        "link.eavesdrop", "mavlink.command", "mavlink.guided", "mavlink.mode", "sensor.compass",
    ]  # fmt: skip
    assert "| ignores | RTL 0.1 s |  | does not apply: the JSON interface has no magnetometer" in rows[-1]
    same = (
        "Of 3 attacks that change a flight of either, the reaction is the same in 3, at the same time and distance in"
    )
    assert f"{same} 2. Of all 4 attacks these are 4 and 3." in page.read_text()
    counted = report.read_agreement(page)
    assert (counted.kinds, counted.same, counted.effective, counted.effective_alike) == (4, 4, 3, 2)


def test_a_kind_that_does_not_reach_the_other_autopilot_is_not_counted() -> None:
    row = ComparedAttack("sensor.compass", OBEYS, IGNORES)
    assert agreement([*COMPARED, row]) == agreement(COMPARED)
    assert report.results([row])["attacks"][0]["does_not_apply"].startswith("the JSON interface")


def test_a_page_without_marks_is_refused(tmp_path: Path) -> None:
    page = tmp_path / "parity.md"
    page.write_text("nothing\n")
    with pytest.raises(InputError, match="without the marks"):
        report.check_page(page)


def test_the_command_prints_and_renews(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    given: list[Any] = []

    def compare(folder: Path, kinds: Any, rates: str, **_: Any) -> list[ComparedAttack]:
        given.append((folder, list(kinds), rates))
        return COMPARED

    monkeypatch.setattr(module, "compare", compare)
    page = tmp_path / "page.md"
    page.write_text(f"{report.TABLE.begin}\n{report.TABLE.end}\n")
    asked = ["parity", "attacks", "mavlink.mode", "--out", str(tmp_path / "a"), "--page", str(page)]
    said = CliRunner().invoke(app, asked, env={"COLUMNS": "160"})
    assert said.exit_code == 0, said.output
    assert given == [(tmp_path / "a", ["mavlink.mode"], "reduced")]
    assert "Of all 4 attacks these are 3 and 2." in said.output
    assert "mavlink.mode" in page.read_text()
    facts = json.loads(CliRunner().invoke(app, [*asked, "--json"]).stdout)
    assert (facts["kinds"], facts["same"]) == (4, 3)
    assert facts["attacks"][1]["ardupilot"]["reaction"] == "ignores"


SEEDED = SeededAttack("mavlink.mode", (OBEYS, IGNORES, replace(OBEYS, at_s=3.0, departed_m=60.0)), (IGNORES,) * 3)


def test_reactions_over_seeds_are_counted_with_their_spread(tmp_path: Path) -> None:
    assert report.seeds_words(SEEDED.first) == ("obeys 2, ignores 1", "1.6 s (0.1 to 3.0)", "40 m (0 to 60)")
    assert report.seeds_words(SEEDED.second) == ("ignores 3", "none", "0 m")
    page = tmp_path / "parity.md"
    other = SeededAttack("link.flood", (OBEYS,), (OBEYS,))
    page.write_text(
        f"{report.TABLE.begin}\nkept\n{report.TABLE.end}\n{report.SEEDS_TABLE.begin}\n{report.SEEDS_TABLE.end}\nafter\n"
    )
    report.renew_seeds([SEEDED], page)
    report.renew_seeds([other], page)
    report.renew_seeds([SEEDED], page)
    rows = [line for line in page.read_text().splitlines() if line.startswith("| `")]
    assert [line.split(" | ")[:2] for line in rows] == [
        ["| `link.flood`", "builtin"], ["| `link.flood`", "ArduCopter"],
        ["| `mavlink.mode`", "builtin"], ["| `mavlink.mode`", "ArduCopter"],
    ]  # fmt: skip
    assert "kept" in page.read_text()
    assert page.read_text().endswith("\nafter\n")


def test_the_command_flies_the_seeds_from_1_on(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    flown_seeds: list[tuple[Path, Any]] = []

    def compare(folder: Path, kinds: Any, rates: str, *, seed: int, on_flight: Any) -> list[ComparedAttack]:
        flown_seeds.append((folder, seed))
        on_flight("mavlink.mode", 1, 4)
        return [ComparedAttack("mavlink.mode", OBEYS, IGNORES)]

    monkeypatch.setattr(module, "compare", compare)
    page = tmp_path / "page.md"
    page.write_text(f"{report.TABLE.begin}\n{report.TABLE.end}\n")
    asked = ["parity", "attacks", "mavlink.mode", "--seeds", "2", "--out", str(tmp_path / "a")]
    refused = CliRunner().invoke(app, [*asked, "--page", str(page)])
    assert isinstance(refused.exception, InputError)
    assert "--seeds: begin" in str(refused.exception)
    assert not flown_seeds
    facts = json.loads(CliRunner().invoke(app, [*asked, "--json"]).stdout)
    assert flown_seeds == [(tmp_path / "a" / f"seed-{seed}", seed) for seed in (1, 2)]
    assert [one["reaction"] for one in facts["attacks"][0]["builtin"]] == ["obeys", "obeys"]


def test_the_kinds_are_all_that_have_an_example() -> None:
    chosen = chosen_kinds([])
    assert set(chosen) == set(EXAMPLES)
    assert set(NOT_CARRIED) <= set(chosen)
    with pytest.raises(InputError, match=r"mavlink\.mode"):
        chosen_kinds(["mavlink.mod"])


@pytest.mark.rotating
def test_flights_are_read_from_a_record(tmp_path: Path) -> None:
    """An order to return by a failsafe of the ground station: texts, modes and landing of a run of the builtin."""
    scenario = load("identity.silence_station")
    record = fly(scenario, tmp_path / "run", report=False)
    (flight,) = read_flights(record).values()
    assert [text for _, text in flight.failsafes] == ["GCS Failsafe"]
    assert [mode for _, mode in flight.modes] == ["GUIDED", "AUTO", "RTL"]
    assert flight.takeoff_s is not None
    assert flight.lost == ()
    assert len(flight.time_s) == len(flight.enu_m)
    assert ordered_vehicles(record) == set()  # frames were dropped, none was sent


@pytest.mark.slow
def test_the_builtin_in_both_roles_agrees(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """One nominal flight serves all flights that differ in their attacks alone."""
    monkeypatch.setattr(module, "_with_autopilot", lambda scenario, *_: scenario)
    names: list[str] = []
    kinds = ["mavlink.command", "mavlink.guided"]
    compared = module.compare(tmp_path, kinds, on_flight=lambda name, *_: names.append(name))
    assert [one.first.reaction for one in compared] == ["crashes", "lands"]
    assert all(one.first == one.second for one in compared)
    assert [name for name in names if name.endswith("nominal")] == ["mavlink.command-builtin-nominal"]


def test_the_pages_give_causes_for_the_rows_that_differ_and_for_no_other() -> None:
    _, _, rest = RESULTS.read_text().partition(report.TABLE.begin)
    table, _, _ = rest.partition(report.TABLE.end)
    _, _, causes = CAUSES.read_text().partition("\n### Causes of differences\n")
    section, _, _ = causes.partition("\n### ")
    differ = {cells[0] for line in _rows(table) if (cells := _cells(line))[-1] != report.YES}
    explained = {kind for line in _rows(section) for kind in _cells(line)[0].split(", ")}
    assert differ
    assert explained == differ


def _rows(text: str) -> list[str]:
    return [line for line in text.splitlines() if line.startswith("| `")]


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_a_missing_arducopter_is_told_before_the_first_flight(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SKYRANGE_ARDUCOPTER", str(tmp_path / "none"))
    told: list[str] = []
    with pytest.raises(InputError, match="no such file"):
        module.compare(tmp_path / "out", ["link.replay"], on_flight=lambda name, *_: told.append(name))
    assert told == []
    assert not (tmp_path / "out").exists()


def test_every_kind_of_attack_is_in_the_table_or_its_absence_is_explained() -> None:
    text = RESULTS.read_text(encoding="utf-8")
    block = text[text.index(report.TABLE.begin) : text.index(report.TABLE.end)]
    rows = {line.split("`")[1] for line in block.splitlines() if line.startswith("| `")}
    assert rows | NOT_FLOWN.keys() == set(kinds(ATTACKS))
    assert not rows & NOT_FLOWN.keys()
