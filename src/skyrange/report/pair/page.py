"""Page of a pair: the tracks of the attacked run and its twin, the propagation timeline and the effects."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from skyrange.core.files import atomic_write
from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.figures.causal_path import draw_causal_path
from skyrange.figures.maps import Place, draw_reception_map
from skyrange.figures.subject import Subject, subject_of
from skyrange.figures.svg import Figure
from skyrange.figures.twins import Span, draw_departures, draw_twin_heights, draw_twin_plan
from skyrange.metrics.defences import read_defences
from skyrange.metrics.links import read_receptions, summarise_receptions
from skyrange.metrics.safety import find_mishaps
from skyrange.metrics.summary import describe_missions
from skyrange.metrics.time_series import RecordedNote, Track, read_notes, truth_tracks
from skyrange.record import RunRecord
from skyrange.report import quantities
from skyrange.report.pair import belief, effect_tables, propagation_timeline
from skyrange.report.pair.effect_tables import describe_attribution
from skyrange.report.pair.moments import MomentFinder, render_incidents
from skyrange.report.rendering import asset, content_policy, render
from skyrange.report.run import sections
from skyrange.report.run.page import colour_rules
from skyrange.report.viewer import at_moment, embed_viewer, join_scripts, link_moment
from skyrange.statistics.means import BOOTSTRAP_FROM, SKEWED
from skyrange.twins.arms import HONEST
from skyrange.twins.causal_path import Step, find_causal_path
from skyrange.twins.pair_folder import Pair
from skyrange.twins.verdict import describe_verdict
from skyrange.view.folders import read_pair_arms
from skyrange.view.opening import LEAD_S

MAX_DRAWN = 12
"""Aircraft in the charts over time: those that departed farthest."""

SCRIPTS: Final = ("packed.js", "rows.js", "moments.js")
"""Parts of the page's own script in order."""

_TWINS = {
    "nominal": "Against the nominal twin: every attack and fault is present and muted.",
    "sham": "Against the sham: the same transmitters, airtime and timing, with benign content.",
}


def write_comparison(pair: Pair, path: Path) -> Path:
    """Write the page of a pair to `path`; figures and timeline are those of its first seed. Raises `OSError`."""
    page = render_comparison(pair)
    with atomic_write(path) as file:
        file.write(page.encode())
    return path


def render_comparison(pair: Pair) -> str:
    """The page as text."""
    seed = pair.seeds[0]
    attacked, twin = pair.run("attacked", seed), pair.run(pair.twin, seed)
    subject = subject_of(attacked)
    tracks, twins = truth_tracks(attacked), truth_tracks(twin)
    events = read_notes(attacked, "events")
    propagation = [row for row in pair.propagation.to_pylist() if row["seed"] == seed]
    effects = pair.effects.to_pylist()
    seed_rows = [row for row in effects if row["seed"] == seed and row["against"] == pair.twin]
    affected = _affected(seed_rows)
    shown = affected[:MAX_DRAWN] or [vehicle.id for vehicle in subject.fleet[:MAX_DRAWN]]
    spans = _spans(events, attacked.duration)
    places = _places(attacked)
    causes = find_causal_path(attacked, propagation)
    embedded = embed_viewer(read_pair_arms(pair, seed))
    style, script = embedded.style + asset("style.css") + colour_rules({}, subject), join_scripts(embedded, *SCRIPTS)
    finder = MomentFinder(attacked, tracks, events)
    return render(
        "pair/page.html.jinja",
        policy=content_policy(style, script),
        script=script,
        stream=embedded.stream,
        opens_s=_opening_s(propagation, seed_rows),
        incidents=render_incidents({"attacked": attacked, pair.twin: twin}, subject),
        verdict=describe_verdict(pair, seed),
        title=f"{pair.manifest['name']} · attacked and not · skyrange",
        style=style,
        name=str(pair.manifest["name"]),
        facts=[
            ("arms", " · ".join(pair.arms)),
            ("missions complete", " · ".join(_missions(pair, arm, seed) for arm in ("attacked", pair.twin))),
            ("seed" if len(pair.seeds) == 1 else "seeds", ", ".join(map(str, pair.seeds))),
        ],
        failed=list(map(str, pair.failed_missions)),
        numbers=_numbers(propagation, seed_rows),
        tables=_tables(attacked, propagation, spans),
        defences=_defences(attacked, twin),
        plan=draw_pair_plan(pair),
        heights=draw_twin_heights(subject, tracks, twins, shown, spans),
        departures=draw_departures(subject, tracks, twins, shown, spans),
        threshold=f"{pair.manifest['threshold_m']:g}",
        chain=propagation_timeline.render_timeline(
            subject, propagation, [row["id"] for row in _declared(attacked)], spans, attacked.duration
        ),
        steps=propagation_timeline.render_steps(subject, propagation),
        causal_path=draw_causal_path(causes, _link_step(subject)) if causes.steps else None,
        seed=seed,
        twin=pair.twin,
        near=f"{pair.manifest['near_m']:g}",
        attribution=describe_attribution(pair, subject, seed),
        effects=[
            _effects(
                subject, [row for row in effects if row["seed"] == seed], arm, finder, truth_tracks(pair.run(arm, seed))
            )
            for arm in pair.twins
        ],
        truth=_lie_and_truth(pair, subject, seed),
        ensemble=_ensemble(pair, subject, effects),
        belief=belief.render_belief((attacked, twin), (tracks, twins), subject, spans, MAX_DRAWN),
        receptions=_receptions(attacked, subject, places),
        folder=str(pair.path),
    )


def _missions(pair: Pair, arm: str, seed: int) -> str:
    states = [str(outcome.get("state")) for outcome in pair.run(arm, seed).outcomes.values()]
    return f"{describe_missions(states).removesuffix(' missions')} {arm}"


def _opening_s(propagation: Sequence[Mapping[str, Any]], effects: Sequence[Mapping[str, Any]]) -> float | None:
    """When the viewer opens: shortly before an aircraft departs, or before the first act where none does."""
    departed = [row["departed_s"] for row in effects if row["departed_s"] is not None]
    acts = [row["at_ns"] / NS_PER_S for row in propagation if row["phase"] == "onset"]
    first = min(departed or acts, default=None)
    return None if first is None else max(first - LEAD_S, 0.0)


def _link_step(subject: Subject) -> Callable[[Step], str]:
    vehicles = {vehicle.id for vehicle in subject.fleet}
    return lambda step: link_moment(step.at_s, step.owner if step.owner in vehicles else "")


def _defences(attacked: RunRecord, twin: RunRecord) -> list[dict[str, Any]]:
    """Rows of the defences: what each did in the attacked run, and its alarms in the twin."""
    alarms = {defence.id: defence.alarms for defence in read_defences(twin)}
    return [
        {
            "id": defence.id,
            "kind": defence.kind,
            "params": defence.params,
            "touches": defence.touches,
            "acts": ", ".join(f"{count} {action}" for action, count in sorted(defence.acts.items())) or "none",
            "first": "none"
            if defence.first_alarm_s is None
            else at_moment(quantities.quantity(defence.first_alarm_s, "s", 2), defence.first_alarm_s),
            "numbers": [str(defence.alarms), str(alarms.get(defence.id, 0))],
        }
        for defence in read_defences(attacked)
    ]


def draw_pair_plan(pair: Pair) -> Figure:
    """Plan view of the attacked run and its twin, of the pair's first seed."""
    seed = pair.seeds[0]
    attacked = pair.run("attacked", seed)
    tracks, events = truth_tracks(attacked), read_notes(attacked, "events")
    seed_rows = [row for row in pair.effects.to_pylist() if row["seed"] == seed and row["against"] == pair.twin]
    spans = _spans(events, attacked.duration)
    return draw_twin_plan(
        subject_of(attacked),
        tracks,
        truth_tracks(pair.run(pair.twin, seed)),
        _affected(seed_rows),
        _places(attacked),
        marks=find_mishaps(events, tracks),
        forged=_forged(attacked, tracks, spans),
        believed=_believed(attacked, spans),
    )


def _affected(effects: Sequence[Mapping[str, Any]]) -> list[str]:
    """Aircraft that departed from their twin, the farthest first."""
    departed = sorted((row for row in effects if row["departed_s"] is not None), key=lambda row: -row["departure_m"])
    return [row["vehicle"] for row in departed]


def _declared(run: RunRecord) -> Sequence[Mapping[str, Any]]:
    return [row for table in ("attacks", "faults") for row in run.manifest.get(table) or []]


def _places(run: RunRecord) -> dict[str, Place]:
    """Positions of attackers and of what they forge, by name."""
    places: dict[str, Place] = {}
    for attack in _declared(run):
        for name, place in attack.get("shown", {}).items():
            places[name if name not in places else f"{name} of {attack['id']}"] = tuple(place)
        for radio in attack.get("radios", []):
            if at_enu_m := radio.get("at_enu_m"):
                places[str(radio["endpoint"])] = tuple(at_enu_m)
    return places


def _forged(run: RunRecord, tracks: Mapping[str, Track], spans: Sequence[Span]) -> dict[str, tuple[Place, Place]]:
    """Aircraft whose position is forged: the true position at the attack's start, and the claimed one."""
    begun = {attack: start for start, _, attack in spans}
    forged: dict[str, tuple[Place, Place]] = {}
    for attack in _declared(run):
        name = str(attack.get("params", {}).get("vehicle"))
        claimed = attack.get("shown", {}).get(f"{name} as claimed")
        track = tracks.get(name)
        if claimed is not None and track is not None and len(track) and attack["id"] in begun:
            east_m, north_m, up_m = track.at(np.array([from_seconds(begun[attack["id"]])]))[0].tolist()
            forged[name] = (east_m, north_m, up_m), tuple(claimed)
    return forged


def _believed(run: RunRecord, spans: Sequence[Span]) -> dict[str, Track]:
    """Believed tracks of aircraft with altered sensors, from the start of the first attack."""
    vehicles = belief.with_altered_sensors(run)
    if not vehicles or not spans:
        return {}
    start_ns = from_seconds(min(start for start, _, _ in spans))
    believed = {name: track.since(start_ns) for name, track in belief.believed_tracks(run, vehicles).items()}
    return {name: track for name, track in believed.items() if len(track)}


def _spans(events: Sequence[RecordedNote], end_s: float) -> list[Span]:
    """When each attack and each fault was active: from its start to its stop or to the run's end."""
    starts, stops = ({f"event.{author}_{what}" for author in ("attack", "fault")} for what in ("start", "stop"))
    begun = {row.about: float(row.data["at_s"]) for row in events if row.kind in starts}
    over = {row.about: float(row.data["at_s"]) for row in events if row.kind in stops}
    return [(start, over.get(attack, end_s), attack) for attack, start in begun.items()]


def _numbers(
    propagation: Sequence[Mapping[str, Any]], effects: Sequence[Mapping[str, Any]]
) -> list[tuple[str, Any, str]]:
    """Tiles at the top of the page: name, value and caption."""
    onset_s = min((row["at_ns"] / NS_PER_S for row in propagation if row["phase"] == "onset"), default=None)
    acts = [row for row in propagation if row["phase"] in ("onset", "act")]
    of_faults = sum(bool(row["fault"]) for row in acts)
    only_faults = bool(acts) and of_faults == len(acts)
    led = [row for row in propagation if row["phase"] == "propagation"]
    decided = [row for row in led if row["kind"] != "frame"]
    first_s, first_vehicle = min(
        ((row["at_ns"] / NS_PER_S, row["vehicle"]) for row in propagation if row["phase"] == "effect"),
        default=(None, ""),
    )
    departed = sum(row["departed_s"] is not None for row in effects)
    delays = [row["delay_s"] for row in effects if row["delay_s"] is not None]
    flown = [row for row in effects if row["outcome"] == row["outcome_twin"]]
    longer = max((row["extra_distance_m"] for row in flown), key=abs, default=None)
    energy = max((row["extra_energy_j"] for row in flown if row["extra_energy_j"] is not None), key=abs, default=None)
    worse = sum(row["outcome"] != row["outcome_twin"] for row in effects)
    return [
        (
            "onset",
            at_moment(quantities.duration(onset_s), onset_s),
            "the first act",
        ),
        (
            "acts of faults" if only_faults else "hostile acts",
            quantities.count(of_faults if only_faults else len(acts) - of_faults),
            "labelled" + (f", {of_faults} of faults" if of_faults and not only_faults else ""),
        ),
        (
            "led to",
            quantities.count(len(decided)),
            f"decisions and events, {quantities.count(len(led) - len(decided))} frames",
        ),
        ("departed", quantities.count(departed), f"of {quantities.count(len(effects))} aircraft"),
        (
            "first effect",
            at_moment(quantities.duration(first_s), first_s, first_vehicle),
            "truth leaves the twin",
        ),
        (
            "delay",
            quantities.signed(max(delays, key=abs, default=None), "s", 1),
            f"the most; {worse} missions with another outcome",
        ),
        ("extra distance", quantities.signed(longer, "m", 1), "the most, same outcome"),
        (
            "extra energy",
            quantities.signed(None if energy is None else energy / 1000.0, "kJ", 2),
            "the most, same outcome",
        ),
    ]


def _tables(run: RunRecord, propagation: Sequence[Mapping[str, Any]], spans: Sequence[Span]) -> list[Mapping[str, Any]]:
    """The tables of attacks and of faults, as far as there are some."""
    acted = {attack: (begin, end) for begin, end, attack in spans}
    tables: list[Mapping[str, Any]] = []
    for author in ("attack", "fault"):
        declared = run.manifest.get(f"{author}s") or []
        if declared:
            rows = [_attack(row, acted.get(row["id"]), propagation) for row in declared]
            tables.append({"author": author, "rows": rows})
    return tables


def _attack(
    row: Mapping[str, Any], acted: tuple[float, float] | None, propagation: Sequence[Mapping[str, Any]]
) -> Mapping[str, Any]:
    count = sum(label["attack"] == row["id"] and label["phase"] in ("onset", "act") for label in propagation)
    given = row.get("params", {})
    params = {name: value for name, value in given.items() if value not in ([], {}, "") and name != "threat"}
    if row.get("anchor"):
        params["anchor"] = row["anchor"]
    begin, end = acted or (None, None)
    return {
        "id": row["id"],
        "kind": row["kind"],
        "params": params,
        "touches": row.get("touches", []),
        "technique": row.get("technique", ""),
        "threat": {name: text for name, text in row.get("threat", {}).items() if text},
        "numbers": (
            at_moment(quantities.quantity(begin, "s", 2), begin),
            at_moment(quantities.quantity(end, "s", 2), end),
            quantities.count(count),
        ),
    }


def _effects(
    subject: Subject,
    effects: Sequence[Mapping[str, Any]],
    against: str,
    finder: MomentFinder,
    twins: Mapping[str, Track],
) -> Mapping[str, str]:
    rows = [row for row in effects if row["against"] == against]
    return {
        "meaning": _TWINS[against],
        "operators": effect_tables.render_operators(subject, rows),
        "aircraft": effect_tables.render_effects(subject, rows, lambda row: finder.find(row, twins)),
    }


def _lie_and_truth(pair: Pair, subject: Subject, seed: int) -> Mapping[str, Any] | None:
    """Reactions to the lie and to the truth, if the honest arm was flown."""
    rows = [row for row in pair.lie_and_truth.to_pylist() if row["seed"] == seed]
    if not rows:
        return None
    aircraft = pair.run(HONEST, seed).manifest.get("honest") or []
    return {
        "aircraft": ", ".join(
            f"{honest_aircraft['id']} ({honest_aircraft['airframe']}, {honest_aircraft['uas_id']})"
            for honest_aircraft in aircraft[:MAX_DRAWN]
        ),
        "count": len(aircraft),
        "table": effect_tables.render_lie_and_truth(subject, rows),
    }


def _ensemble(pair: Pair, subject: Subject, effects: Sequence[Mapping[str, Any]]) -> Mapping[str, Any] | None:
    if len(pair.seeds) < 2:
        return None
    affected = list(dict.fromkeys(row["vehicle"] for row in effects if row["departed_s"] is not None))
    table = effect_tables.render_ensemble(subject, pair.intervals(), affected)
    constants = {"bootstrap_from": BOOTSTRAP_FROM, "skewed": SKEWED}
    return {"seeds": len(pair.seeds), "reference": pair.reference, "table": table, **constants}


def _receptions(run: RunRecord, subject: Subject, places: Mapping[str, Place]) -> Mapping[str, Any] | None:
    rows = summarise_receptions(run)
    if not rows:
        return None
    hostile = read_receptions(run, [row["id"] for row in _declared(run) if row.get("radios")])
    drawing = draw_reception_map(subject, hostile, places) if len(hostile) else None
    return {"map": drawing, "table": sections.render_receptions(rows)}
