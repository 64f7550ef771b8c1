"""Effects that outlast the acts of an attack: what a record shows of them, and how alarms about them are scored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.dataset.labels import read_acts, trace_frames
from skyrange.metrics.time_series import RecordedNote, read_notes
from skyrange.scenario.shipped import EXAMPLES
from skyrange.scoring.result_file import ScoreSettings
from skyrange.scoring.scores import score_detectors
from skyrange.study.measurement import measure_acts
from tests.flights import shared_run
from tests.unit.score_sample import alert, attack, flight, tables

CONTENT = ("inject", "replace", "send")
"""Acts by which an attack writes something: not those that delay or drop what others write."""
STORED = frozenset({"event.mission", "event.fence", "event.rally", "event.parameter", "event.home"})
"""Events by which an autopilot says that it has stored something, which it keeps."""
MENDED: Final[Mapping[str | None, frozenset[str]]] = {
    "acts": frozenset(),
    "mode": frozenset(),
    "upload": frozenset({"event.mission", "event.fence", "event.rally"}),
    "flight": STORED,
}
"""What of it is no longer in force when the effect of a kind ends, as it says."""


def written_by_attacks(name: str) -> set[str]:
    """The kinds of events that say that an autopilot has taken over what an attack's own frames told it."""
    record = shared_run(name)
    acts = read_acts(record)
    own = replace(acts, acts=[act for act in acts.acts if act.role == "attack" and act.action in CONTENT])
    frames = set(trace_frames(record, own).ids.to_pylist())
    notes: list[RecordedNote] = read_notes(record, "events")
    return {note.kind for note in notes if frames & set(note.causes)}


def _mark(name: str) -> tuple[pytest.MarkDecorator, ...]:
    """Slow where nothing of the kind goes over a link that leads to an autopilot."""
    links = {"gcs", "log", "autopilot", "approval", "uss"}
    return (pytest.mark.slow,) * links.isdisjoint(AttackPlugin.find(name).surface)


@pytest.mark.catalogue
@pytest.mark.parametrize("name", [pytest.param(name, marks=_mark(name)) for name in sorted(EXAMPLES)])
def test_a_kind_persists_as_it_says(name: str) -> None:
    """Nothing that an autopilot keeps of what an attack told it outlasts the effect that the kind declares."""
    assert not written_by_attacks(name) & STORED - MENDED[AttackPlugin.find(name).persists]


def test_alarms_about_an_altered_flight_detect_it_until_it_ends() -> None:
    """The mission is altered within seconds, and flown for more than a minute."""
    record = shared_run("mavlink.mission_alter")
    (act,) = measure_acts(record)
    disarmed_s = [note.time_ns / 1e9 for note in read_notes(record, "events") if note.kind == "event.disarmed"]
    assert act["effect_end_s"] == disarmed_s[-1]
    assert act["last_s"] + 10.0 < 20.0 < 60.0 < act["effect_end_s"]
    row = attack(
        "r", act["vehicle"], active_s=act["first_s"], observable_s=act["first_s"], stop_s=act["last_s"],
        effect_end_s=act["effect_end_s"],
    )  # fmt: skip
    flights = [flight("r", act["vehicle"], arm="attacked"), flight("v", split="validation"), flight("n")]
    settings = ScoreSettings(replicates=100)

    def recalls(*times_s: float) -> tuple[float, float, int, int]:
        alerts = [alert("r", time_s, act["vehicle"]) for time_s in times_s]
        file = score_detectors(tables(flights, [row], alerts), settings, ["d"])
        (score,) = (one for one in file.detectors if one.detector == "d")
        one, lasting = score.sets[0], score.effect_sets[0]
        assert one.detection.recall is not None
        assert lasting.detection.recall is not None
        return (
            one.detection.recall.value, lasting.detection.recall.value,
            one.false_alarms.hostile.episodes, lasting.false_alarms.hostile.episodes,
        )  # fmt: skip

    assert recalls(*(20.0 + 2.0 * number for number in range(20))) == (0.0, 1.0, 2, 0)
    assert recalls(act["effect_end_s"] + 10.1) == (0.0, 0.0, 1, 1)
    assert recalls(act["last_s"]) == (1.0, 1.0, 0, 0)
