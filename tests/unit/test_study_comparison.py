"""Sections and figures of the page of a pair."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from skyrange.figures.maps import draw_reception_map
from skyrange.figures.palette import shades
from skyrange.figures.subject import Subject
from skyrange.figures.twins import draw_departures, draw_twin_heights, draw_twin_plan
from skyrange.metrics.links import (
    ReceptionSummary,
    read_receptions,
    reception_summaries,
    summarise_receptions,
)
from skyrange.metrics.safety import min_building_distance_m
from skyrange.metrics.time_series import Track, Vehicle
from skyrange.report.pair import belief, effect_tables, propagation_timeline
from skyrange.report.pair.moments import MomentFinder, Moments
from skyrange.report.run import sections
from skyrange.statistics.means import Interval
from tests.unit.study_sample import SampleRun

S = 1_000_000_000
FLEET = [Vehicle(name, "a", "builtin", "iris", "", (0.0, 10.0 * k, 0.0)) for k, name in enumerate(("a/1", "a/2<b>"))]
CITY = [{"height_m": 30.0, "rings": [[[5, -5], [15, -5], [15, 5], [5, 5], [5, -5]]]}]
SUBJECT = Subject(
    "page", FLEET, dict(zip(("a/1", "a/2<b>"), shades("#0072b2", 2), strict=True)), CITY, {"a/1": 0, "a/2<b>": 1}
)


def track(*places: tuple[float, float, float]) -> Track:
    enu_m = np.array(places, dtype=np.float64)
    return Track(np.arange(len(places), dtype=np.int64) * S, enu_m, np.zeros(len(places)))


TWINS = {"a/1": track((0, 0, 0), (0, 0, 10), (20, 0, 10)), "a/2<b>": track((0, 10, 0), (0, 10, 5), (0, 10, 5))}
TRACKS = {"a/1": track((0, 0, 0), (0, 0, 10), (0, 20, 14)), "a/2<b>": TWINS["a/2<b>"]}


def test_both_tracks_are_in_the_plan_with_the_attackers_places() -> None:
    drawn = draw_twin_plan(SUBJECT, TRACKS, TWINS, ["a/1"], {"ghost <1>": (10.0, 12.0, 10.0)}).svg
    assert len(re.findall(r'class="line ink-0"', drawn)) == 2
    assert drawn.count("stroke-dasharray") == 1, "the twin of the one that departed, not of the other"
    assert 'class="line ink-1"' in drawn
    assert "plan-buildings" in drawn
    assert "ghost &lt;1&gt;" in drawn
    assert "<1>" not in drawn


def test_whose_identity_is_forged_is_on_the_map() -> None:
    plain = draw_twin_plan(SUBJECT, TRACKS, TWINS, ["a/1"], {}).svg
    forged = {"a/2<b>": ((0.0, 10.0, 5.0), (200.0, 10.0, 5.0))}
    drawn = draw_twin_plan(SUBJECT, TRACKS, TWINS, ["a/1"], {"claimed": (200.0, 10.0, 5.0)}, forged=forged).svg
    assert "where it is said to be" in drawn
    assert plain.count('class="home') == 1
    assert drawn.count('class="home') == 2
    assert "a/2&lt;b&gt;" in drawn


def test_what_a_deceived_aircraft_believes_is_on_the_map() -> None:
    plain = draw_twin_plan(SUBJECT, TRACKS, TWINS, ["a/1"], {}).svg
    drawn = draw_twin_plan(SUBJECT, TRACKS, TWINS, ["a/1"], {}, believed={"a/2<b>": track((0, 10, 0), (90, 10, 0))}).svg
    assert "where it believes to be" not in plain
    assert "a/2&lt;b&gt;: where it believes to be" in drawn


def deceived_run(path: Path) -> SampleRun:
    """One whose first aircraft's GNSS lies: what its estimator said of it."""
    manifest = {"origin": {}, "vehicles": [{"id": vehicle.id, "operator": "a"} for vehicle in FLEET]}
    label = {"at_ns": 5 * S, "attack": "x", "actor": "x.gnss", "action": "sensor", "frame": "gnss:a/1|fwd|x.gnss|0"}
    said = [
        (6.4, "event.glitch", "a/1", '{"on": true}'),
        (6.5, "event.glitch", "a/2<b>", '{"on": true}'),
        (15.2, "event.estimator", "a/1", '{"reset": "position", "east_m": 30.0}'),
        (16.0, "event.mode", "a/1", '{"mode": "LAND", "reason": "ekf_failsafe"}'),
        (17.0, "event.mode", "a/1", '{"mode": "RTL", "reason": "gcs_command"}'),
    ]
    events = [
        {"time_ns": round(at * S), "kind": kind, "about": about, "source": "autopilot", "data": data, "causes": []}
        for at, kind, about, data in said
    ]
    return SampleRun(path, manifest, CITY, {"labels": [label], "events": events})


def test_what_estimators_noted_of_false_sensors_is_told(tmp_path: Path) -> None:
    run = deceived_run(tmp_path)
    section = belief.render_belief((run, run), (TRACKS, TWINS), SUBJECT, [(5.0, 9.0, "x")], 12)
    cells = [re.sub(r"<[^>]*>", "", cell) for cell in re.findall(r"<td[^>]*>(.*?)</td>", section)]
    assert cells[1::4] == ["glitch", "estimator", "mode"]
    assert cells[0::4] == ["a/1"] * 3, "the other one's sensors were not touched"
    assert "reset position east_m 30" in cells[6]
    assert "did not request EKF_STATUS_REPORT" in section
    quiet = SampleRun(tmp_path, run.manifest, CITY, {})
    assert belief.render_belief((quiet, quiet), (TRACKS, TWINS), SUBJECT, [], 12) == ""


def test_places_that_are_one_share_a_ring_and_a_swarm_goes_without_names() -> None:
    places = {"radio": (10.0, 12.0, 2.0), "ghost": (10.0, 12.0, 10.0), "ghost 1": (19.0, 12.0, 10.0)}
    drawn = draw_twin_plan(SUBJECT, TRACKS, TWINS, ["a/1"], places).svg
    assert drawn.count('class="hostile"') == 2
    assert "radio · ghost</text>" in drawn
    assert "ghost 1</text>" not in drawn
    assert "ghost 1: 19 m east" in drawn


def cost(vehicle: str, delay_s: float | None, departed_s: float | None) -> dict[str, object]:
    more = dict.fromkeys(("near_misses", "near_misses_twin", "collisions", "collisions_twin"), 1)
    return {
        "vehicle": vehicle, "delay_s": delay_s, "departed_s": departed_s, "extra_distance_m": 2.0,
        "extra_energy_j": None, "outcome": "complete", "outcome_twin": "complete", **more,
    }  # fmt: skip


def test_operators_pay_for_all_their_aircraft() -> None:
    table = effect_tables.render_operators(SUBJECT, [cost("a/1", 3.0, 1.0), cost("a/2<b>", None, None)])
    cells = [re.sub(r"<[^>]*>", "", cell) for cell in re.findall(r"<td[^>]*>(.*?)</td>", table)]
    assert cells == ["2", "1", "0", "+3.00\u202fs", "+4.0\u202fm", "0.00\u202fkJ", "2", "2"]
    assert effect_tables.render_operators(SUBJECT, [cost("a/1", 3.0, 1.0)]) == "", "one aircraft each says it all"


def test_heights_and_departures_are_drawn_with_the_attacks_interval() -> None:
    spans = [(0.5, 1.5, "ghost")]
    heights = draw_twin_heights(SUBJECT, TRACKS, TWINS, ["a/1"], spans).svg
    assert heights.count('class="span"') == 1
    assert heights.count("stroke-dasharray") == 1
    departures = draw_departures(SUBJECT, TRACKS, TWINS, ["a/1", "a/9"], spans).svg
    assert "stroke-dasharray" not in departures
    # (0, 20, 14) against (20, 0, 10): 28.6 m, so the axis has a tick at 20 and none at 40
    assert ">20</text>" in departures
    assert ">40</text>" not in departures


def test_only_operators_that_are_drawn_are_named() -> None:
    fleet = [FLEET[0], Vehicle("b/1", "b<c>", "builtin", "iris", "", (0.0, 0.0, 0.0))]
    subject = Subject(
        "page", fleet, dict(zip(("a/1", "b/1"), shades("#0072b2", 2), strict=True)), [], {"a/1": 0, "b/1": 1}
    )
    tracks = {"a/1": TWINS["a/1"], "b/1": TWINS["a/2<b>"]}
    named = re.compile(r'font-weight="600" fill="#\w+">([^<]*)<')
    for chosen, names in ((["a/1"], ["a"]), (["a/1", "b/1"], ["b&lt;c&gt;", "a"])):
        assert named.findall(draw_twin_heights(subject, tracks, tracks, chosen, []).svg) == names
        assert named.findall(draw_departures(subject, tracks, tracks, chosen, []).svg) == names
    assert not named.findall(draw_twin_heights(SUBJECT, TRACKS, TWINS, ["a/1"], []).svg), "one operator needs no name"


def test_nothing_to_draw_draws_nothing() -> None:
    empty = {vehicle.id: Track(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0)) for vehicle in FLEET}
    draw_twin_plan(SUBJECT, empty, empty, [], {})
    draw_departures(SUBJECT, empty, empty, ["a/1"], [])
    assert "No hostile act" in propagation_timeline.render_timeline(SUBJECT, [], [], [], 10.0)
    assert "No aircraft" in effect_tables.render_effects(SUBJECT, [], lambda _: Moments())


def row(phase: str, at_s: float, kind: str, vehicle: str | None, **more: object) -> dict[str, object]:
    base = {
        "phase": phase,
        "at_ns": round(at_s * S),
        "kind": kind,
        "vehicle": vehicle,
        "attack": "ghost",
        "source": "x",
    }
    return {"fault": False, "depth": None, "data": None, "departure_m": None, "frame": None, **base, **more}


def test_the_chain_has_a_lane_for_the_attack_and_for_each_aircraft_it_reached() -> None:
    labels = [
        row("onset", 1.0, "send", None),
        row("act", 2.0, "send", None),
        row("propagation", 2.1, "frame", "a/1", depth=1),
        row("propagation", 2.2, "decision.avoid", "a/1", depth=2, data='{"why": "<ghost>"}'),
        row("effect", 3.0, "departure", "a/1", departure_m=12.3),
    ]
    drawn = propagation_timeline.render_timeline(SUBJECT, labels, ["ghost"], [(1.0, 4.0, "ghost")], 10.0)
    assert drawn.count('class="lane"') == 2
    assert 'x="10%"' in drawn
    assert 'x="22%"' in drawn
    assert 'x="30%"' in drawn
    assert "a/2" not in drawn
    told = propagation_timeline.render_steps(SUBJECT, labels)
    assert [told.index(word) for word in (">onset<", ">propagation<", ">effect<")] == sorted(
        told.index(word) for word in (">onset<", ">propagation<", ">effect<")
    )
    assert "&lt;ghost&gt;" in told
    assert "<ghost>" not in told
    assert "12.3 m" in told


def test_a_flood_of_acts_is_thinned() -> None:
    labels = [row("onset", 0.0, "send", None), *(row("act", 0.001 * k, "send", None) for k in range(5000))]
    drawn = propagation_timeline.render_timeline(SUBJECT, labels, ["ghost"], [], 10.0)
    assert drawn.count("<title>") <= propagation_timeline.MAX_MARKS + 2


def effect(vehicle: str, **more: object) -> dict[str, object]:
    base: dict[str, object] = {"vehicle": vehicle, "outcome": "unfinished", "outcome_twin": "complete", "delay_s": None}
    for name in ("min_separation", "min_wall"):
        base |= {f"{name}_m": None, f"{name}_twin_m": 4.0}
    for name in ("near_misses", "collisions"):
        base |= {name: 2, f"{name}_twin": 0}
    return base | {"extra_distance_m": -3.04, "extra_energy_j": None, "departure_m": 9.0, "departed_s": 2.0} | more


def test_effects_are_said_with_signs_and_those_that_departed_first() -> None:
    rows = [effect("a/1", departure_m=0.0, departed_s=None), effect("a/2<b>")]
    drawn = effect_tables.render_effects(SUBJECT, rows, lambda _: Moments(nearest_s=7.25))
    assert drawn.index("a/2&lt;b&gt;") < drawn.index("a/1")
    assert "−3.0" in drawn
    assert "0 → 2" in drawn
    assert "4.0 → far" in drawn
    assert drawn.count("class=quiet") == 1
    assert '<a href="#t=2.00&amp;select=a/2%3Cb%3E">2.0' in drawn, "a departure leads to its moment"
    assert drawn.count("#t=7.25") == 4, "the least separations and near misses of both"


@given(st.lists(st.tuples(*[st.floats(-90.0, 90.0)] * 6), min_size=2, max_size=9))
def test_moments_are_those_of_the_numbers(places: list[tuple[float, ...]]) -> None:
    here, there = (np.array(places)[:, part] for part in (slice(0, 3), slice(3, 6)))
    away_m = np.linalg.norm(here - there, axis=1)
    finder = MomentFinder(
        SampleRun(Path(), {}, CITY, {}), {"a/1": track(*here.tolist()), "a/2<b>": track(*there.tolist())}, []
    )
    found = effect(
        "a/1", nearest="a/2<b>", min_separation_m=float(away_m.min()), finished_s=8.0, landed_s=None, min_wall_m=1.0
    )
    moments = finder.find(found, {"a/1": track(*there.tolist())})
    assert away_m[round(moments.farthest_s or 0.0)] == away_m.max()
    assert away_m[round(moments.nearest_s or 0.0)] == away_m.min()
    assert (moments.end_s, moments.collision_s) == (8.0, None)
    walls_m = min_building_distance_m(here[None], np.ones((1, len(here)), np.bool_), CITY)
    assert walls_m[round(moments.wall_s or 0.0)] == walls_m.min()


def test_intervals_are_bold_where_they_leave_zero_out() -> None:
    found = {"a/1": {"delay_s": Interval(5, 3.0, 1.0, 5.0, "t"), "extra_distance_m": Interval(5, 3.0, -1.0, 7.0, "t")}}
    drawn = effect_tables.render_ensemble(SUBJECT, found, ["a/1"])
    assert len(re.findall(r"<b>\+3\.0", drawn)) == 1
    assert "−1.0 … 7.0, n = 5" in drawn


def heard(path: Path) -> SampleRun:
    rows = [
        ("ghost", "a/1", (0.0, 0.0, 10.0), -60.0, "decoded"),
        ("ghost", "a/1", (5.0, 0.0, 10.0), -70.0, "decoded"),
        ("a/1", "a/2<b>", (0.0, 10.0, 5.0), -90.0, "decoded"),
        ("ghost", "a/2<b>", (0.0, 10.0, 5.0), -97.0, "weak"),
    ]
    vehicles = [{"id": vehicle.id, "operator": "a"} for vehicle in FLEET]
    return SampleRun(
        path,
        {"vehicles": vehicles, "receivers": [{"id": "mast"}]},
        [],
        {
            "receptions": [
                {
                    "time_ns": k * S, "link": f"rid_up:{sender}", "receiver": receiver, "rssi_dbm": dbm, "outcome": how,
                    **dict(zip(("east_m", "north_m", "up_m"), place, strict=True)),
                }
                for k, (sender, receiver, place, dbm, how) in enumerate(rows)
            ]
        },
    )  # fmt: skip


def test_who_heard_whom_by_hand(tmp_path: Path) -> None:
    found = summarise_receptions(heard(tmp_path))
    assert found == [
        ReceptionSummary("a/2<b>", "a/1", 1, 1, -90.0, -90.0, 2.0, 2.0, None),
        ReceptionSummary("a/1", "ghost", 2, 2, -65.0, -60.0, 0.0, 1.0, 1.0),
        ReceptionSummary("a/2<b>", "ghost", 0, 1, -97.0, -97.0, None, None, None),
    ]
    assert "a/2&lt;b&gt;" in sections.render_receptions(found)
    assert summarise_receptions(heard(tmp_path), ["a/1"]) == found[1:2]
    assert reception_summaries(heard(tmp_path)) == [found[1], found[0]], "by receiver, and only what was decoded"


def test_what_was_heard_in_several_batches_is_one_row(tmp_path: Path) -> None:
    one = {"link": "rid_up:ghost", "receiver": "a/1", "outcome": "decoded", "rssi_dbm": -60.0}
    many = [{**one, "time_ns": k * S, "outcome": "decoded" if k % 2 else "weak"} for k in range(2500)]
    (found,) = summarise_receptions(SampleRun(tmp_path, {}, [], {"receptions": many}))
    assert (found.decoded, found.of, found.first_s, found.last_s, found.silence_s) == (1250, 2500, 1.0, 2499.0, 2.0)


def test_the_map_has_a_dot_per_reception_of_the_attackers(tmp_path: Path) -> None:
    hostile = read_receptions(heard(tmp_path), ["ghost"])
    drawn = draw_reception_map(SUBJECT, hostile, {"ghost.radio": (10.0, 0.0, 2.0)}).svg
    assert drawn.count("hears ghost") == 3
    assert "hears a/1" not in drawn
    assert drawn.count('r="3.4" fill="none"') == 1, "what was not decoded is hollow"
    assert "-97 dBm" in drawn
    assert len(read_receptions(heard(tmp_path), [])) == 0
