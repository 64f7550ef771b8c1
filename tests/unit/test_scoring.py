"""Scoring of detectors on made-up studies: rules of matching, thresholds, sets, the result file and the leaderboard."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from skyrange.cli.output.score_tables import tabulate_scores
from skyrange.core.errors import InputError
from skyrange.core.time import NEVER, NS_PER_S
from skyrange.scoring.detector_measures import judge_claim
from skyrange.scoring.index import index_alerts, index_study
from skyrange.scoring.leaderboard import rank_detectors
from skyrange.scoring.matching import Outcome, choose_threshold, find_episodes, match_alarms
from skyrange.scoring.result_file import ScoreFile, ScoreSettings, SetScore, read_scores, write_scores
from skyrange.scoring.scores import score_detectors
from skyrange.scoring.tables import ALERTS, ATTACKS, FLIGHTS, StudyTables, check_tables
from tests.unit.score_sample import alert, attack, flight, intrusion, tables

EPISODE_NS = 30 * NS_PER_S
SETTINGS = ScoreSettings(replicates=200)


def outcome_of(given: StudyTables, threshold: float = -math.inf) -> Outcome:
    index = index_study(given, 10.0)
    return match_alarms(index, index_alerts(index, given.alerts, "d"), threshold, EPISODE_NS)


def detection_s(given: StudyTables) -> list[float]:
    return [math.inf if at == NEVER else at / NS_PER_S for at in outcome_of(given).detected_ns.tolist()]


def on_all(file: ScoreFile, detector: str = "d") -> SetScore:
    score = next(one for one in file.detectors if one.detector == detector)
    found = score.on("all")
    assert found is not None
    return found


def test_an_episode_is_as_long_as_it_says_from_its_beginning() -> None:
    times = np.array([0, 10, 29, 30, 59, 61, 200], dtype=np.int64)
    begins = find_episodes(np.zeros(7, dtype=np.int64), times, 30)
    assert times[begins].tolist() == [0, 30, 61, 200]
    assert find_episodes(np.array([0, 1, 1]), np.array([5, 5, 6]), 30).tolist() == [True, True, False]


@pytest.mark.parametrize(
    ("time_s", "detected", "false"),
    [
        (999.9, False, 1),  # before the onset
        (1000.0, False, 0),  # acts, but could not be seen
        (1009.9, False, 0),
        (1010.0, True, 0),
        (1070.0, True, 0),  # the end of the grace
        (1070.1, False, 1),
    ],
)
def test_windows_of_an_attack(time_s: float, detected: bool, false: int) -> None:
    given = tables([flight("r", arm="attacked")], [attack("r")], [alert("r", time_s)])
    outcome = outcome_of(given)
    assert (outcome.detected_ns[0] != NEVER) == detected
    assert outcome.false_alarms.sum() == false


@pytest.mark.parametrize(
    ("time_s", "detected", "false"),
    [
        (1009.9, False, 0),
        (1070.0, True, 0),
        (1070.1, True, 0),
        (1200.0, True, 0),
        (1310.0, True, 0),
        (1310.1, False, 1),
    ],
)
def test_windows_of_an_effect(time_s: float, detected: bool, false: int) -> None:
    """Its effect lasts 240 s longer than it acts: alarms meanwhile detect it; one after it and the grace is false."""
    given = tables([flight("r", arm="attacked")], [attack("r", effect_end_s=1300.0)], [alert("r", time_s)])
    index = index_study(given, 10.0, "effect")
    outcome = match_alarms(index, index_alerts(index, given.alerts, "d"), -math.inf, EPISODE_NS)
    assert (outcome.detected_ns[0] != NEVER) == detected
    assert outcome.false_alarms.sum() == false
    assert index.subjects.exposure_ns.tolist() == [(3600 - 310) * NS_PER_S, 0]


def test_both_scores_are_told_and_that_of_the_acts_does_not_depend_on_effects() -> None:
    flights = [flight(f"r{n}", arm="attacked") for n in range(4)] + [flight("v", split="validation"), flight("n")]
    alerts = [alert("r0", 1200.0 + 30.0 * number) for number in range(4)] + [alert("r1", 1020.0), alert("r2", 1311.0)]
    files = [
        score_detectors(tables(flights, [attack(f"r{n}", effect_end_s=end_s) for n in range(4)], alerts), SETTINGS)
        for end_s in (1060.0, 1300.0)
    ]
    short, lasting = ({one.detector: one for one in file.detectors} for file in files)
    for name, score in lasting.items():
        assert score.sets == short[name].sets
        assert score.effect_sets[0] != score.sets[0]
        assert short[name].effect_sets == short[name].sets
    found = lasting["d"].effect_on("all")
    assert found is not None
    assert (found.detection.detected, on_all(files[1]).detection.detected) == (2, 1)
    assert (found.false_alarms.hostile.episodes, on_all(files[1]).false_alarms.hostile.episodes) == (1, 5)
    assert lasting["always"].effect_sets[0].detection.recall == short["always"].sets[0].detection.recall
    row = next(one for one in rank_detectors([files[1]]) if one.detector == "d")
    assert (row.recall, row.effect_recall) == (0.25, 0.5)
    assert (row.hostile_false_per_h or 0.0) > (row.effect_hostile_false_per_h or 0.0) > 0.0


def test_an_alarm_about_another_aircraft_is_false_and_detects_nothing() -> None:
    flights = [flight("r", name, arm="attacked", aircraft=2) for name in ("a", "b")]
    given = tables(flights, [attack("r")], [alert("r", 1020.0, "b"), alert("r", 1020.0, "")])
    assert detection_s(given) == [math.inf]
    assert outcome_of(given).false_alarms.sum() == 2


def test_an_attack_on_a_whole_run_is_detected_by_any_subject() -> None:
    flights = [flight("r", name, arm="attacked", aircraft=2) for name in ("a", "b")]
    given = tables(flights, [attack("r", "")], [alert("r", 1040.0, "b"), alert("r", 1030.0, "")])
    assert detection_s(given) == [1030.0]
    assert outcome_of(given).false_alarms.sum() == 0


def test_an_alarm_about_a_harmless_intrusion_is_neither_a_detection_nor_false() -> None:
    flights = [flight("r", arm="sham"), flight("s", arm="sham"), flight("v", split="validation")]
    acts = [intrusion("r"), intrusion("s", "")]
    alerts = [alert("r", at) for at in (990.0, 1000.0, 1070.0, 1071.0)]
    given = tables(flights, (), alerts, acts)
    found = on_all(score_detectors(given, SETTINGS))
    assert (found.harmless_intrusions.intrusions, found.harmless_intrusions.reported) == (2, 1)
    assert found.harmless_intrusions.share is not None
    assert found.harmless_intrusions.share.value == 0.5
    assert (found.detection.attacks, found.detection.recall) == (0, None)
    assert found.false_alarms.sham.episodes == 2, "before the onset, and after the grace"
    assert found.false_alarms.sham.hours == pytest.approx((7200.0 - 140.0) / 3600.0)
    assert on_all(score_detectors(given, SETTINGS), "always").harmless_intrusions.reported == 2


def test_alarms_about_harmless_intrusions_choose_no_threshold() -> None:
    flights = [flight("v", split="validation", arm="fault"), flight("t")]
    acts = [intrusion("v", active_s=100.0, stop_s=900.0)]
    given = tables(flights, (), [alert("v", 100.0 * number, score=float(number)) for number in range(1, 10)], acts)
    index = index_study(given, 10.0)
    assert choose_threshold(index, index_alerts(index, given.alerts, "d"), 1.0, EPISODE_NS).threshold == -math.inf


def test_an_intrusion_that_belongs_to_no_flight_is_an_error() -> None:
    for wrong in (intrusion("q"), intrusion("r", "z"), intrusion("r", stop_s=900.0)):
        with pytest.raises(InputError, match="intrusions, row 0"):
            tables([flight("r")], (), (), [wrong])


def test_an_alarm_that_stands_at_the_onset_detects_and_pays_per_episode() -> None:
    every_s = [alert("r", float(time)) for time in range(3600)]
    given = tables([flight("r", arm="attacked")], [attack("r")], every_s)
    assert detection_s(given) == [1010.0]
    assert outcome_of(given).false_alarms.sum() == math.ceil(1000 / 30) + math.ceil((3600 - 1071) / 30)


def test_hours_of_an_attacked_aircraft_leave_out_the_attack() -> None:
    flights = [flight("r", name, arm="attacked", aircraft=2) for name in ("a", "b")]
    acts = [attack("r"), attack("r", attack_id="y", active_s=1050.0, observable_s=1050.0, stop_s=1100.0)]
    hours = index_study(tables(flights, acts), 10.0).subjects.exposure_ns / NS_PER_S
    assert hours.tolist() == [3600.0 - 110.0, 3600.0, 0.0]


def test_what_could_not_be_observed_is_no_miss() -> None:
    acts = [attack("r", observable_s=math.nan), attack("r", attack_id="y", observable_s=1071.0)]
    file = score_detectors(
        tables([flight("r", arm="attacked"), flight("v", split="validation")], acts), SETTINGS, detectors=["d"]
    )
    found = on_all(file).detection
    assert (found.attacks, found.unobservable, found.recall, found.delay) == (2, 2, None, None)
    assert on_all(file, "always").false_alarms.hostile.episodes == math.ceil(1000 / 30) + math.ceil(2529 / 30)


def test_a_threshold_is_the_lowest_that_validation_allows_and_reads_nothing_else() -> None:
    flights = [flight("v", split="validation"), flight("w", split="validation", arm="fault"), flight("t")]
    benign = [alert("v", 100.0 * score, score=score) for score in range(10)] + [alert("w", 5.0, score=8.5)]
    loud = [alert("t", 100.0 * score, score=100.0 + score) for score in range(10)]

    def choose(alerts: list[dict[str, Any]], target_per_h: float) -> tuple[float, int]:
        given = tables(flights, (), alerts)
        index = index_study(given, 10.0)
        found = choose_threshold(index, index_alerts(index, given.alerts, "d"), target_per_h, EPISODE_NS)
        return found.threshold, int(found.episodes.sum())

    assert choose(benign, 1.0) == (8.0, 2)
    assert choose(benign, 1.0) == choose(benign + loud, 1.0)
    assert choose(benign, 0.4) == (9.0, 0)
    assert choose(benign, 100.0) == (-math.inf, 11)
    with pytest.raises(InputError, match="validation"):
        score_detectors(tables([flight("t")], (), [alert("t", 1.0)]), SETTINGS)


def test_before_the_effect_counts_misses() -> None:
    flights = [flight(f"r{n}", arm="attacked") for n in range(4)] + [flight("v", split="validation")]
    acts = [attack(f"r{n}", effect_s=1030.0) for n in range(3)] + [attack("r3", effect_s=1005.0)]
    alerts = [alert("r0", 1020.0), alert("r1", 1030.0), alert("r3", 1012.0)]
    found = on_all(score_detectors(tables(flights, acts, alerts), SETTINGS)).detection.before_effect
    assert found is not None
    assert (found.attacks, found.unavoidable, found.share.value) == (4, 1, 0.25)
    assert found.lead_quartiles_s == (None, -7.0, 0.0)


def test_delays_are_censored() -> None:
    flights = [flight(f"r{n}", arm="attacked") for n in range(3)] + [flight("v", split="validation")]
    acts = [attack(f"r{n}") for n in range(3)]
    given = tables(flights, acts, [alert("r0", 1012.0)])
    found = on_all(score_detectors(given, SETTINGS)).detection.delay
    assert found is not None
    assert found.median_s is None
    assert found.restricted_mean_s == pytest.approx((2 + 60 + 60) / 3)


@pytest.mark.parametrize(
    ("episodes", "hours", "clusters", "verdict"),
    [
        (0, 2.9, 1000, "cannot be claimed"),
        (0, 3.1, 1000, "claimed"),
        (0, 3.1, 5, "cannot be claimed"),  # five that may differ by twice their mean
        (0, 10.0, 20, "claimed"),
        (3, 5.0, 50, "not shown"),
        (2, 30.0, 50, "claimed"),
        (40, 10.0, 50, "exceeded"),
        (40, 1.0, 2, "exceeded"),
        (4, 1.0, 2, "cannot be claimed"),
        (0, 0.0, 0, "cannot be claimed"),
    ],
)
def test_claims(episodes: int, hours: float, clusters: int, verdict: str) -> None:
    counts, spans = np.zeros(clusters), np.full(clusters, hours / max(clusters, 1))
    counts[: min(clusters, episodes)] = episodes / max(1, min(clusters, episodes))
    assert judge_claim(counts, spans, ScoreSettings()).verdict == verdict


def test_a_flight_counts_once_however_many_points_it_was_flown_at() -> None:
    flights = [flight(f"n{n}", flight="same" if n < 16 else f"{n}", cluster="c") for n in range(20)]
    flights += [flight("v", split="validation"), flight("r", arm="attacked", flight="same", cluster="c")]
    alerts = [alert(f"n{n}", 50.0) for n in range(16)]
    file = score_detectors(tables(flights, [attack("r")], alerts), SETTINGS)
    found = on_all(file)
    assert file.repeated_runs == 15
    assert (found.false_alarms.nominal.episodes, found.false_alarms.nominal.hours) == (1, 5.0)
    assert found.detection.attacks == 1, "an attack that only listens flies the nominal flight, and is to be found"


def test_two_attacks_that_only_listen_are_both_to_be_found() -> None:
    """They leave the nominal flight as it is, so that both runs are that flight."""
    flights = [flight(f"r{n}", arm=arm, block="b", flight="same", hostile=True) for n, arm in enumerate(("one", "two"))]
    acts = [attack("r0", kind="link.eavesdrop", family="a"), attack("r1", kind="mavlink.exfiltrate", family="a")]
    file = score_detectors(tables([*flights, flight("v", split="validation")], acts), SETTINGS, detectors=["d"])
    assert [one.name for one in on_all(file).kinds] == ["link.eavesdrop", "mavlink.exfiltrate"]


def test_by_chance_of_an_attack_on_a_whole_run_knows_alarms_without_a_subject() -> None:
    """In the cluster with a nominal flight, and in one without, whose alarms are those of the split."""
    flights = [flight("n", block="p0", cluster="s"), flight("v", split="validation")]
    flights += [flight(f"r{n}", arm="attacked", block=f"p{n}", cluster=("s", "t")[n]) for n in range(2)]
    alerts = [alert("n", float(second), "") for second in range(3600)]
    file = score_detectors(tables(flights, [attack("r0", ""), attack("r1", "")], alerts), SETTINGS)
    assert on_all(file).detection.by_chance == 1.0


def test_always_is_hit_by_chance_even_where_aircraft_take_off_late() -> None:
    flights = [flight("n", block="b", duration_s=60.0), flight("v", split="validation")]
    flights += [flight("r", arm="attacked", block="b", duration_s=60.0)]
    file = score_detectors(tables(flights, [attack("r")]), SETTINGS, detectors=["d"])
    found = on_all(file, "always").detection
    assert found.recall is not None
    assert (found.recall.value, found.by_chance) == (1.0, 1.0)


def test_what_a_run_shares_with_the_nominal_one_counts_there_alone() -> None:
    arms = [flight("n", block="b"), flight("f", arm="fault", block="b", own_from_s=600.0, shared_s=500.0)]
    arms += [flight("r", arm="attacked", block="b", own_from_s=1000.0, shared_s=900.0), flight("v", split="validation")]
    alerts = [alert(run, time) for run in ("n", "f", "r") for time in (50.0, 700.0)] + [alert("r", 2000.0)]
    found = on_all(score_detectors(tables(arms, [attack("r")], alerts), SETTINGS)).false_alarms
    assert [(one.episodes, one.hours) for one in (found.nominal, found.fault, found.hostile)] == [
        (2, 1.0), (1, 3100 / 3600), (1, (3600 - 900 - 70) / 3600),
    ]  # fmt: skip


def test_clusters_and_flights_lie_in_one_split() -> None:
    for name in ("cluster", "flight"):
        with pytest.raises(InputError, match=f"as in the other runs of {name} x"):
            tables([flight("r", **{name: "x"}), flight("s", split="train", **{name: "x"})])
    with pytest.raises(InputError, match=r"0 to duration_s, 3600"):
        tables([flight("r", shared_s=4000.0)])


def test_a_median_takes_more_than_half_of_the_attacks() -> None:
    """Two of four are detected, but one of the others is watched for 11 s alone: the curve falls to a third."""
    flights = [flight(f"r{n}", arm="attacked") for n in range(4)] + [flight("v", split="validation")]
    acts = [attack(f"r{n}", stop_s=1060.0 if n else 1011.0) for n in range(4)]
    alerts = [alert(f"r{n}", 1050.0 + n) for n in (1, 2)]
    delay = on_all(score_detectors(tables(flights, acts, alerts), SETTINGS)).detection.delay
    assert delay is not None
    assert (delay.median_s, delay.median_clusters) == (None, None)


def study_with_everything_held_out() -> StudyTables:
    """Blocks of all arms; the test part has a kind, a family, a city and a fleet size of its own."""
    flights, acts, alerts = [], [], []
    for number in range(12):
        split = ("train", "validation", "test")[number % 3]
        new = split == "test" and number % 2 == 0
        names = ["a", "b"] if new else ["a"]
        for arm in ("nominal", "attacked", "sham", "fault"):
            run = f"{number}-{arm}"
            flights += [
                flight(
                    run, name, arm=arm, block=f"b{number}", split=split,
                    aircraft=len(names), city="manhattan" if new else "plain",
                )
                for name in names
            ]  # fmt: skip
            alerts += [alert(run, 17.0 * number, score=0.1 * number), alert(run, 900.0 + number, score=0.4)]
        other = {"kind": "link.jam", "family": "link"} if new else {}
        acts.append(attack(f"{number}-attacked", **other))
        alerts.append(alert(f"{number}-attacked", 1011.0 + number, score=2.0))
    return tables(flights, acts, alerts)


def test_sets_of_what_is_held_out_and_what_is_seen() -> None:
    file = score_detectors(study_with_everything_held_out(), SETTINGS, study="made up")
    assert file.held_out.model_dump() == {
        "kinds": ("link.jam",), "families": ("link",), "cities": ("manhattan",), "aircraft": (2,),
    }  # fmt: skip
    score = next(one for one in file.detectors if one.detector == "d")
    sizes = {one.name: (one.blocks, one.detection.attacks) for one in score.sets}
    assert sizes == {
        "all": (4, 4),
        "held-out kinds": (4, 2), "seen kinds": (4, 2),
        "held-out families": (4, 2), "seen families": (4, 2),
        "held-out cities": (2, 2), "seen cities": (2, 2),
        "held-out fleet sizes": (2, 2), "seen fleet sizes": (2, 2),
    }  # fmt: skip
    whole = on_all(file)
    assert [group.name for group in whole.kinds] == ["gnss.drift", "link.jam"]
    assert sum(group.detected for group in whole.families) == whole.detection.detected == 4
    assert whole.false_alarms.nominal.hours == pytest.approx(6.0)


def test_arms_of_a_block_are_counted_apart() -> None:
    flights = [flight(arm, arm=arm, block="b") for arm in ("nominal", "sham", "fault")]
    given = tables([*flights, flight("v", split="validation")], (), [alert(one["run"], 50.0) for one in flights])
    found = on_all(score_detectors(given, SETTINGS)).false_alarms
    counts = (found.nominal.episodes, found.sham.episodes, found.fault.episodes, found.hostile.episodes)
    assert counts == (1, 1, 1, 0)


def test_a_file_is_read_as_it_was_written(tmp_path: Path) -> None:
    file = score_detectors(study_with_everything_held_out(), SETTINGS)
    write_scores(file, tmp_path / "scores.json")
    assert read_scores(tmp_path / "scores.json") == file
    (tmp_path / "other.json").write_text('{"format": "skyrange.bench"}')
    with pytest.raises(InputError, match=r"skyrange\.scores/4"):
        read_scores(tmp_path / "other.json")
    (tmp_path / "older.json").write_text(json.dumps(file.model_dump(mode="json") | {"format": "skyrange.scores/3"}))
    with pytest.raises(InputError, match="Score the study again"):
        read_scores(tmp_path / "older.json")
    text = (tmp_path / "scores.json").read_text().replace('"trivial"', '"trivail"')
    (tmp_path / "wrong.json").write_text(text)
    with pytest.raises(InputError, match="trivial"):
        read_scores(tmp_path / "wrong.json")


def test_a_leaderboard_ranks_by_recall_at_the_target_rate_then_delay() -> None:
    flights = [flight(f"n{n}", split=("validation", "test")[n % 2]) for n in range(40)]
    flights += [flight(f"r{n}", arm="attacked") for n in range(4)]
    acts = [attack(f"r{n}") for n in range(4)]
    alerts = [alert(f"r{n}", 1020.0, detector="slow") for n in range(3)]
    alerts += [alert(f"r{n}", 1012.0, detector="quick") for n in range(3)]
    alerts += [alert("r0", 1010.0, detector="blind")]
    file = score_detectors(tables(flights, acts, alerts), SETTINGS, study="one")
    rows = rank_detectors([file])
    assert [(row.rank, row.detector) for row in rows] == [
        (1, "quick"), (2, "slow"), (3, "blind"), (4, "always"), (4, "never"),
    ]  # fmt: skip
    assert (rows[3].recall, rows[3].equal_rate_recall, rows[3].claim) == (1.0, 0.0, "exceeded")
    assert [row.trivial for row in rows] == [False, False, False, True, True]
    theirs = file.model_copy(update={"study": "two", "digest": "other"})
    both = rank_detectors([file, theirs])
    assert [(row.rank, row.study, row.same_study) for row in both[:3]] == [
        (1, "one", True),
        (1, "two", False),
        (3, "one", True),
    ]
    with pytest.raises(InputError, match="settings"):
        rank_detectors([file, theirs.model_copy(update={"settings": ScoreSettings()})])
    with pytest.raises(InputError, match="one of all"):
        rank_detectors([file], "held-out moons")


def test_rankings_mark_a_detector_that_is_reduced_and_say_what_it_lacks() -> None:
    flights = [flight("v", split="validation"), flight("n"), flight("r", arm="attacked")]
    alerts = [alert("r", 1020.0, detector="whole"), alert("r", 1030.0, detector="part")]
    given = tables(flights, [attack("r")], alerts)
    file = score_detectors(given, SETTINGS, reduced={"part": "no commands of motors", "absent": "all"})
    assert {row.detector: row.reduced for row in rank_detectors([file]) if row.reduced} == {
        "part": "no commands of motors"
    }
    printed = list(tabulate_scores([file]))
    for table in printed:
        column = next(one for one in table.columns if one.header == "detector")
        assert "part\n(reduced)" in list(column.cells)
        assert "whole" in list(column.cells)
    assert "part: no commands of motors." in str(printed[0].caption)
    assert "reduced" not in str(next(tabulate_scores([score_detectors(given, SETTINGS)])).caption)


def test_by_time_alarms_at_the_median_onset_of_training() -> None:
    flights = [flight(f"r{n}", arm="attacked", split="train") for n in range(3)]
    flights += [flight("t", arm="attacked"), flight("v", split="validation")]
    acts = [attack(f"r{n}", observable_s=1001.0 + 10 * n) for n in range(3)] + [attack("t")]
    file = score_detectors(tables(flights, acts), SETTINGS, detectors=["d"])
    delay = on_all(file, "by-time").detection.delay
    assert delay is not None
    assert delay.median_s == 1.0
    assert on_all(file, "d").detection.detected == 0


def test_by_chance_is_what_alarms_without_sight_would_detect() -> None:
    flights = [flight("n"), flight("v", split="validation")] + [flight(f"r{n}", arm="attacked") for n in range(40)]
    alerts = [alert("n", 100.0 * number, score=0.0) for number in range(36)]
    acts = [
        attack(f"r{n}", active_s=1000.0 + 7 * n, observable_s=1000.0 + 7 * n, stop_s=1050.0 + 7 * n) for n in range(40)
    ]
    file = score_detectors(tables(flights, acts, alerts), SETTINGS)
    chance = on_all(file).detection.by_chance
    assert chance is not None
    assert chance == pytest.approx(0.6, abs=0.06)  # windows of 60 s, an alarm every 100 s
    assert on_all(file, "always").detection.by_chance == 1.0
    assert on_all(file, "never").detection.by_chance == 0.0


@pytest.mark.rotating
def test_alarms_at_random_detect_what_by_chance_says() -> None:
    random = np.random.default_rng(1)
    flights = [flight("v", split="validation")]
    flights += [flight(f"{arm}{n}", arm=arm) for n in range(150) for arm in ("nominal", "attacked")]
    acts = [attack(f"attacked{n}", stop_s=1000.0 + 4.0 * n) for n in range(150)]
    for n in range(150):
        acts[n] |= {"active_s": 6.0 * n, "observable_s": 6.0 * n, "stop_s": 10.0 * n, "effect_end_s": 10.0 * n}
    alerts = [alert(one["run"], time) for one in flights[1:] for time in random.uniform(0.0, 3600.0, random.poisson(6))]
    found = on_all(score_detectors(tables(flights, acts, alerts), SETTINGS)).detection
    assert found.recall is not None
    assert found.by_chance is not None
    assert 0.3 < found.by_chance < 0.7
    assert abs(found.recall.value - found.by_chance) < 4 * math.sqrt(0.25 / 150)


@pytest.mark.parametrize(
    ("flights", "attacks", "alerts", "message"),
    [
        ([flight("r"), flight("r")], [], [], "each aircraft of a run once"),
        ([flight("r"), flight("r", "b", city="elsewhere")], [], [], "as in the other rows of run r"),
        ([flight("r", block="x", cluster="1"), flight("s", block="x", cluster="2", split="train")], [], [], "block x"),
        ([flight("r", split="tset")], [], [], "train, validation or test"),
        ([flight("r", duration_s=-1.0)], [], [], "no negative time"),
        ([flight("r", duration_s=math.nan)], [], [], "finite numbers"),
        ([flight("r")], [attack("r")], [], "a run whose flights are hostile"),
        ([flight("r", arm="attacked")], [], [], "an attack of this run"),
        ([flight("run-1", arm="attacked")], [attack("run-2")], [], "Did you mean 'run-1'"),
        ([flight("r", arm="attacked")], [attack("r", "z")], [], "an aircraft of run r, or ''"),
        ([flight("r", arm="attacked")], [attack("r", stop_s=1.0)], [], "not before 1000"),
        ([flight("r", arm="attacked")], [attack("r", effect_end_s=1050.0)], [], "not before stop_s, 1060"),
        ([flight("r", arm="attacked")], [attack("r", observable_s=1.0)], [], "not before active_s"),
        ([flight("r", arm="attacked")], [attack("r"), attack("r")], [], "each episode of acting once"),
        (
            [flight("r", arm="attacked")],
            [attack("r"), attack("r", attack_id="y", family="other")],
            [],
            "as in the other rows of kind gnss.drift",
        ),
        ([flight("r")], [], [alert("q", 1.0)], "a run of the flights"),
        ([flight("r")], [], [alert("r", 1.0, "ghost")], "an aircraft of run r, or ''"),
        ([flight("r")], [], [alert("r", math.inf)], "finite numbers"),
        ([flight("r")], [], [alert("r", 1.0, detector="always")], "none of always, by-time, never"),
    ],
)
def test_bad_tables_are_named(
    flights: list[dict[str, Any]], attacks: list[dict[str, Any]], alerts: list[dict[str, Any]], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        tables(flights, attacks, alerts)


def test_missing_columns_and_wrong_types_are_named_together() -> None:
    flights = pa.Table.from_pylist([flight("r")], schema=FLIGHTS).rename_columns(
        ["city_name" if name == "city" else name for name in FLIGHTS.names]
    )
    flights = flights.set_column(FLIGHTS.get_field_index("aircraft"), "aircraft", pa.array(["many"]))
    with pytest.raises(InputError) as caught:
        check_tables(flights, ATTACKS.empty_table(), ALERTS.empty_table())
    assert [problem.where for problem in caught.value.problems] == ["flights", "flights.aircraft"]
    nulls = pa.table({name: pa.nulls(1, FLIGHTS.field(name).type) for name in FLIGHTS.names})
    with pytest.raises(InputError, match="a value in each row"):
        check_tables(nulls, ATTACKS.empty_table(), ALERTS.empty_table())
