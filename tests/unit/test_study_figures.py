"""Figures of a run, and the time series they are drawn from."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skyrange import figures
from skyrange.codec.mavlink import Packer, dialect
from skyrange.core.geodesy import Origin
from skyrange.figures.palette import OKABE_ITO, PAPER, base_colours, contrast, shades, theme_colour
from skyrange.figures.svg import format_tick, path_data, ticks
from skyrange.figures.track_simplification import select_samples
from skyrange.metrics.links import link_statistics, sum_by_kind
from skyrange.metrics.paths import received_waypoints
from skyrange.metrics.time_series import (
    belief_errors_m,
    belief_tracks,
    labelled_acts,
    last_activity_ns,
    read_notes,
    truth_tracks,
)
from tests.unit.study_sample import HOMES, ORIGIN, S, SampleRun, fleet_of, fly, squares

XML = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> SampleRun:
    return squares(tmp_path_factory.mktemp("run"), hostile=True)


def lines_of(svg: str, index: int) -> list[ET.Element]:
    root = ET.fromstring(svg)
    return [node for node in root.iter(XML + "path") if f"line ink-{index}" in node.get("class", "")]


def test_truth_is_read_per_aircraft_in_time_order(run: SampleRun) -> None:
    tracks = truth_tracks(run)
    assert list(tracks) == list(HOMES)
    b1 = tracks["blue/b1"]
    assert len(b1) == 600
    assert (np.diff(b1.time_ns) > 0).all()
    assert b1.enu_m[0].tolist() == [5.0, 5.0, 0.0]
    assert b1.enu_m[:, 2].max() == pytest.approx(5.0, abs=1e-9)
    assert b1.distance_m == pytest.approx(4 * 5 + 2 * 5, rel=0.05)  # the square, up and down; wobble lengthens it


def test_belief_comes_from_received_positions_only(run: SampleRun) -> None:
    truth, belief = truth_tracks(run)["green/g1"], belief_tracks(run)["green/g1"]
    assert len(belief) == 300  # every other sample; VFR_HUD rows with their own `alt` are no positions
    gap = belief_errors_m(truth, belief)
    assert 0.0 < gap.max() < 2.0
    at = truth.at(belief.time_ns)
    assert gap[7] == pytest.approx(math.dist(at[7], belief.enu_m[7]))


def test_altitude_above_sea_becomes_height_above_the_origin(run: SampleRun) -> None:
    belief = belief_tracks(run)["blue/b2"]
    assert abs(float(belief.enu_m[0, 2])) < 0.1
    assert ORIGIN["alt_msl_m"] > 100  # or the assertion above would prove nothing


def test_an_operator_never_sees_another_operators_aircraft(run: SampleRun, tmp_path: Path) -> None:
    received_broadcasts = SampleRun(tmp_path, run.manifest, [], dict(run._rows))
    received_broadcasts._rows["telemetry"] = [{**row, "operator": "blue"} for row in run._rows["telemetry"]]
    tracks = belief_tracks(received_broadcasts)
    assert len(tracks["blue/b1"]) == 300
    assert len(tracks["green/g1"]) == 0


def test_without_a_position_there_is_no_belief(run: SampleRun, tmp_path: Path) -> None:
    rows = {**run._rows, "telemetry": [row for row in run._rows["telemetry"] if row["message"] == "VFR_HUD"]}
    assert all(len(track) == 0 for track in belief_tracks(SampleRun(tmp_path, run.manifest, [], rows)).values())


def test_a_sample_that_is_not_a_number_is_left_out(run: SampleRun, tmp_path: Path) -> None:
    rows = dict(run._rows)
    rows["truth"] = [dict(row) for row in rows["truth"]]
    rows["truth"][3]["up_m"] = math.nan
    assert len(truth_tracks(SampleRun(tmp_path, run.manifest, [], rows))["blue/b1"]) == 599


def test_labelled_acts_name_the_aircraft_whose_link_was_touched(run: SampleRun) -> None:
    acts = labelled_acts(run)
    assert {act.about for act in acts} == {"blue/b1"}
    assert [act.kind for act in acts[:3]] == ["attack.inject", "attack.delay", "attack.delay"]


@pytest.mark.parametrize(
    ("label", "kind"),
    [
        ({"benign": True}, "harmless.inject"),
        ({"benign": True, "harmless_intrusion": True}, "harmless.inject"),
        ({"benign": True, "fault": True}, "fault.inject"),
        ({}, "attack.inject"),
    ],
)
def test_acts_of_a_sham_are_no_hostile_acts(run: SampleRun, label: dict[str, bool], kind: str) -> None:
    rows = {**run._rows, "labels": [{**run._rows["labels"][0], **label}]}
    assert [act.kind for act in labelled_acts(SampleRun(run.path, run.manifest, [], rows))] == [kind]


def test_damaged_details_are_kept_as_text(tmp_path: Path) -> None:
    row = {"time_ns": 1, "kind": "event.x", "about": "a", "source": "s", "data": "{half", "causes": None}
    record = SampleRun(tmp_path, {}, [], {"events": [row]})
    assert read_notes(record, "events")[0].data == {"text": "{half"}


def test_the_view_ends_when_all_is_calm(run: SampleRun) -> None:
    calm = last_activity_ns(truth_tracks(run).values(), read_notes(run, "events"))
    assert calm is not None
    assert calm == pytest.approx(37.2 * S, abs=0.3 * S)  # b2's outcome, the last thing noted
    assert last_activity_ns([], []) is None


def test_link_statistics_count_every_fate(run: SampleRun) -> None:
    stats = {(s.kind, s.owner, s.direction): s for s in link_statistics(run)}
    gcs = stats["gcs", "blue/b1", "rev"]
    mine = [row for row in run._rows["frames"] if row["link"] == "gcs:blue/b1"]
    assert gcs.sent == len(mine) == 150
    assert gcs.fates["lost"] == sum(row["fate"] == "lost" for row in mine)
    assert gcs.size_bytes == sum(row["size"] for row in mine)
    delays = sorted((row["arrived_ns"] - row["sent_ns"]) * 1e-9 for row in mine if row["arrived_ns"] is not None)
    assert gcs.mean_latency_s == pytest.approx(sum(delays) / len(delays), rel=1e-9)
    assert gcs.p95_latency_s == pytest.approx(delays[math.ceil(0.95 * len(delays)) - 1], rel=0.01)
    silent = stats["gcs", "blue/b1", "fwd"]
    assert silent.sent == 0
    assert math.isnan(silent.mean_latency_s)
    assert math.isnan(silent.p95_latency_s)


def test_sums_by_kind_add_up(run: SampleRun) -> None:
    stats = link_statistics(run)
    total = {(s.kind, s.direction): s for s in sum_by_kind(stats)}
    assert total["log", "rev"].sent == 750
    assert sum(s.sent for s in total.values()) == len(run._rows["frames"])
    assert next(s for s in stats if s.owner == "blue/b1" and s.kind == "log" and s.direction == "rev").sent == 150


def test_waypoints_are_those_that_arrived(run: SampleRun, tmp_path: Path) -> None:
    origin = Origin(ORIGIN["lat_deg"], ORIGIN["lon_deg"])
    packer = Packer(255, 190)
    payloads: list[dict[str, Any]] = []
    frames: list[dict[str, Any]] = []

    def item(seq: int, east: float, command: int, fate: str = "delivered") -> None:
        lat, lon = origin.geodetic_of(east, 20.0)
        message = dialect.MAVLink_mission_item_int_message(
            1, 1, seq, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, command, 0, 1, 0, 0, 0, 0,
            round(lat * 1e7), round(lon * 1e7), 30.0,
        )  # fmt: skip
        number = len(payloads)
        payloads.append({"payload_id": number, "payload": packer.pack(message)})
        frames.append(
            {"link": "gcs:blue/b1", "direction": "fwd", "fate": fate, "payload_id": number, "sent_ns": number}
        )

    item(0, 1.0, dialect.MAV_CMD_NAV_WAYPOINT)  # ArduPilot's item 0 is the home
    item(1, 2.0, dialect.MAV_CMD_NAV_TAKEOFF)
    item(2, 10.0, dialect.MAV_CMD_NAV_WAYPOINT)
    item(3, 40.0, dialect.MAV_CMD_NAV_WAYPOINT, "lost")
    item(4, 50.0, dialect.MAV_CMD_NAV_WAYPOINT)
    item(4, 50.0, dialect.MAV_CMD_NAV_WAYPOINT)  # sent again: drawn once
    payloads[2]["payload"] = payloads[2]["payload"]
    payloads.append({"payload_id": 99, "payload": payloads[4]["payload"][:-1] + b"\0"})  # a broken checksum
    frames.append({"link": "gcs:blue/b1", "direction": "fwd", "fate": "delivered", "payload_id": 99, "sent_ns": 99})
    found = received_waypoints(SampleRun(tmp_path, run.manifest, [], {"payloads": payloads, "frames": frames}))
    assert found["blue/b1"].round(1).tolist() == [[10.0, 20.0, 30.0], [50.0, 20.0, 30.0]]


def test_thinning_keeps_its_promise_and_its_budget() -> None:
    time_ns = np.arange(4000, dtype=np.int64) * 10_000_000
    t = time_ns * 1e-9
    path = np.stack([np.sin(t) * 30, np.cos(t / 3) * 30, t * 0.1], axis=1)
    rows = select_samples(time_ns, path, 4000, 0.05)
    again = np.stack([np.interp(time_ns, time_ns[rows], path[rows, k]) for k in range(3)], axis=1)
    assert np.sqrt(((again - path) ** 2).sum(axis=1)).max() <= 0.05
    assert 10 < len(rows) < 1000
    few = select_samples(time_ns, path, 50, 0.0)
    assert len(few) == 50
    assert few[0] == 0
    assert few[-1] == 3999


def test_thinning_sees_a_halt_that_a_line_would_hide() -> None:
    # Straight on, but waiting in the middle: the shape is a line, the timing is not.
    x = np.concatenate([np.linspace(0, 10, 50), np.full(100, 10.0), np.linspace(10, 20, 50)])
    rows = select_samples(np.arange(200, dtype=np.int64), np.stack([x, 0 * x], axis=1), 100, 0.01)
    assert {49, 150} <= {int(r) for r in rows} | {int(r) + 1 for r in rows}


@pytest.mark.parametrize("count", [0, 1, 2])
def test_short_tracks_are_kept_whole(count: int) -> None:
    assert select_samples(np.arange(count, dtype=np.int64), np.zeros((count, 3)), 2, 1.0).tolist() == list(range(count))


def test_colours_without_a_wish_come_from_okabe_ito_and_stand_out() -> None:
    chosen = base_colours({"a": "", "b": "#123456", "c": "", "d": "blue", "e": "javascript:alert(1)"})
    assert chosen["b"] == "#123456"
    assert chosen["d"] == OKABE_ITO[0]
    assert {chosen["a"], chosen["c"], chosen["e"]} <= set(OKABE_ITO[1:])
    assert len({chosen[key] for key in "acde"}) == 4
    for colour in (*OKABE_ITO, "#000000", "#ffffff", "#0000ff"):
        for each in (theme_colour(colour), *shades(colour, 5)):
            assert contrast(each.light, PAPER["light"]) >= 3.0  # WCAG 2.2, 1.4.11
            assert contrast(each.dark, PAPER["dark"]) >= 3.0
    assert len(set(shades("#009e73", 3))) == 3


def test_contrast_matches_the_standards_own_example() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)  # WCAG 2.2, "contrast ratio": 1 to 21
    assert contrast("#777777", "#777777") == pytest.approx(1.0)


def test_ticks_are_round_and_inside() -> None:
    assert ticks(-3.2, 17.0, 5) == ([0.0, 5.0, 10.0, 15.0], 5.0)
    assert [format_tick(v, 0.5) for v in (0.0, 0.5, -1.0)] == ["0", "0.5", "−1.0"]


def test_a_path_ends_where_it_should() -> None:
    points = np.array([[0.0, 0.0], [0.04, 0.0], [10.26, 3.0], [10.26, 3.0], [-5.0, 8.06]])
    numbers = [float(text) for text in re.findall(r"-?[\d.]+", path_data(points))]
    assert [round(sum(numbers[0::2]), 6), round(sum(numbers[1::2]), 6)] == [-5.0, 8.1]


def test_each_operators_box_holds_its_own_aircraft_only(run: SampleRun) -> None:
    both = figures.trajectories_3d(run)
    assert all(len(lines_of(both.svg, index)) == 2 for index in range(5))  # the path and its shadow
    blue = figures.trajectories_3d(run, ["blue"])
    assert [len(lines_of(blue.svg, index)) for index in range(5)] == [2, 2, 0, 0, 0]
    assert "east, m" in blue.svg
    with pytest.raises(ValueError, match=r"red.*blue, green"):
        figures.trajectories_3d(run, ["red"])


def test_belief_and_truth_are_different_drawings(run: SampleRun) -> None:
    belief, truth = figures.trajectories_3d(run), figures.trajectories_3d(run, source="truth")
    assert lines_of(belief.svg, 0)[1].get("d") != lines_of(truth.svg, 0)[1].get("d")


def test_plan_view_has_its_scale_right(run: SampleRun) -> None:
    figure = figures.plan_view(run, {"blue/b1": np.array([[5.0, 10.0, 5.0]])})
    root = ET.fromstring(figure.svg)
    bar = next(node for node in root.iter(XML + "g") if node.get("class") == "scale-bar")
    line = bar.find(XML + "path")
    assert line is not None
    drawn = re.match(r"M([\d.]+).*H([\d.]+)V", line.get("d", ""))
    assert drawn is not None
    start, end = (float(x) for x in drawn.groups())
    metres = float(bar.find(XML + "text").text.split()[0])  # type: ignore[union-attr]
    homes = [node.find(XML + "circle") for node in root.iter(XML + "g") if "home" in node.get("class", "")]
    x, y = ([float(home.get(axis, "")) for home in homes if home is not None] for axis in ("cx", "cy"))
    scale = (end - start) / metres
    assert math.hypot(x[0] - x[1], y[0] - y[1]) / scale == pytest.approx(math.hypot(5, 5), rel=0.01)  # b1 to b2
    assert y[0] < y[4]  # b1 is north of g3
    assert len(lines_of(figure.svg, 0)) == 2  # the path and one waypoint
    assert len([node for node in root.iter(XML + "path") if node.get("fill-rule") == "evenodd"]) >= 1


def test_altitude_reaches_the_top_of_the_flight(run: SampleRun) -> None:
    root = ET.fromstring(figures.altitude(run).svg)
    words = [node.text for node in root.iter(XML + "text")]
    assert "simulated time, s" in words
    assert "4" in words
    assert all(len(lines_of(figures.altitude(run).svg, index)) == 1 for index in range(5))


def test_a_figure_shows_itself_and_saves(run: SampleRun, tmp_path: Path) -> None:
    figure = figures.altitude(run)
    assert figure._repr_svg_() == figure.svg
    assert figure.svg in figure._repr_html_()
    assert ET.parse(figure.save(tmp_path / "a.svg")).getroot().get("aria-label") == figure.title


def test_names_cannot_break_out_of_a_drawing(tmp_path: Path) -> None:
    record = fly(tmp_path, {"a/x": ((0, 0), 3.0, 4.0)}, {"a": "<b>"}, [], seconds=20)
    record.manifest["name"] = '<script>alert("1")</script>'
    for figure in (figures.trajectories_3d(record), figures.plan_view(record), figures.altitude(record)):
        ET.fromstring(figure.svg)
        assert "<script" not in figure.svg


def test_nothing_flown_still_draws(tmp_path: Path) -> None:
    record = SampleRun(tmp_path, {"name": "empty", "operators": [{"id": "a"}], "vehicles": [{"id": "a/x"}]}, [], {})
    assert "nothing was received" in figures.trajectories_3d(record).svg
    for figure in (figures.plan_view(record), figures.altitude(record)):
        ET.fromstring(figure.svg)
    ET.fromstring(figures.plan_view(SampleRun(tmp_path, {}, [], {})).svg)


def test_a_hundred_aircraft_stay_light(tmp_path: Path) -> None:
    record = fly(tmp_path, fleet_of(100, 4), {f"op{k}": "" for k in range(4)}, [], seconds=100, rate_hz=2)
    for figure in (figures.trajectories_3d(record), figures.plan_view(record), figures.altitude(record)):
        assert len(figure.svg) < 600_000
