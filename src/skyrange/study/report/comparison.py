"""What did the attack do, on one page that needs no network? The twins' tracks, the chain, the table of effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.record import RunRecord
from skyrange.study.marks import marks
from skyrange.study.pair_folder import Pair
from skyrange.study.receptions import receptions_of, who_heard_whom
from skyrange.study.report import believing, chain, effecttable, hearing, words
from skyrange.study.report.page import asset, ink_rules, sealed
from skyrange.study.report.sections import LOGO
from skyrange.study.series import Happening, Track, happenings, truth_tracks
from skyrange.study.subject import Subject, subject_of
from skyrange.study.svg import Figure
from skyrange.study.twins import Place, Span, draw_departures, draw_twin_heights, draw_twin_plan

MOST_DRAWN = 12
"""Aircraft in the charts over time: those that departed most."""

_TWINS = {
    "nominal": "Against the nominal twin: every attack present and muted.",
    "sham": "Against the sham: the same transmitters, airtime and timing with benign content.",
}


def write_comparison(pair: Pair, path: Path) -> Path:
    """Write the page of a pair; the pictures and the chain are those of its first seed."""
    page = render(pair)
    draft = path.with_name(path.name + ".part")
    try:
        draft.write_text(page, encoding="utf-8")
        draft.replace(path)
    except OSError:
        draft.unlink(missing_ok=True)
        raise
    return path


def render(pair: Pair) -> str:
    """The whole page as text."""
    seed = pair.seeds[0]
    attacked, twin = pair.run("attacked", seed), pair.run("nominal", seed)
    subject = subject_of(attacked)
    tracks, twins = truth_tracks(attacked), truth_tracks(twin)
    events = happenings(attacked, "events")
    labels = [row for row in pair.labels.to_pylist() if row["seed"] == seed]
    effects = pair.effects.to_pylist()
    own = [row for row in effects if row["seed"] == seed and row["against"] == "nominal"]
    affected = _affected(own)
    shown = affected[:MOST_DRAWN] or [vehicle.id for vehicle in subject.fleet[:MOST_DRAWN]]
    spans = _spans(events, attacked.duration)
    places = _places(attacked)
    style = asset("style.css") + ink_rules({}, subject)
    return Template(asset("comparison.html")).substitute(
        policy=sealed(style),
        title=escape(f"{pair.manifest['name']} · attacked and not · skyrange"),
        style=style,
        masthead=_masthead(pair),
        tiles=_tiles(labels, own),
        attacks=_attacks(attacked, labels, spans),
        plan=plan_of(pair).svg,
        heights=draw_twin_heights(subject, tracks, twins, shown, spans).svg,
        departures=draw_departures(subject, tracks, twins, shown, spans).svg,
        threshold=f"{pair.manifest['threshold_m']:g}",
        chain=chain.chain(subject, labels, [row["id"] for row in _declared(attacked)], spans, attacked.duration),
        steps=chain.steps(subject, labels),
        against=f"Of seed {seed}. A near miss is another aircraft nearer than {pair.manifest['near_m']:g} m.",
        effects="".join(_effects(subject, effects, seed, arm) for arm in pair.arms if arm != "attacked"),
        ensemble=_ensemble(pair, subject, effects),
        belief=believing.belief((attacked, twin), (tracks, twins), subject, spans, MOST_DRAWN),
        hearing=_hearing(attacked, subject, places),
        opening=_SNIPPET.format(path=escape(str(pair.path), quote=True)),
    )


def plan_of(pair: Pair) -> Figure:
    """Both flights from above, of the pair's first seed."""
    seed = pair.seeds[0]
    attacked = pair.run("attacked", seed)
    tracks, events = truth_tracks(attacked), happenings(attacked, "events")
    own = [row for row in pair.effects.to_pylist() if row["seed"] == seed and row["against"] == "nominal"]
    spans = _spans(events, attacked.duration)
    return draw_twin_plan(
        subject_of(attacked),
        tracks,
        truth_tracks(pair.run("nominal", seed)),
        _affected(own),
        _places(attacked),
        marks(events, tracks),
        _forged(attacked, tracks, spans),
        _believed(attacked, spans),
    )


def _affected(effects: Sequence[Mapping[str, Any]]) -> list[str]:
    """Aircraft that departed from their twin, those that did most first."""
    departed = sorted((row for row in effects if row["departed_s"] is not None), key=lambda row: -row["departure_m"])
    return [row["vehicle"] for row in departed]


def _declared(run: RunRecord) -> Sequence[Mapping[str, Any]]:
    return list(run.manifest.get("attacks") or [])


def _places(run: RunRecord) -> dict[str, Place]:
    """Where attackers stand and what they pretend to be, by name."""
    found: dict[str, Place] = {}
    for attack in _declared(run):
        for name, place in attack.get("shown", {}).items():
            found[name if name not in found else f"{name} of {attack['id']}"] = tuple(place)
        for radio in attack.get("radios", []):
            found[str(radio["endpoint"])] = tuple(radio["at_enu_m"])
    return found


def _forged(run: RunRecord, tracks: Mapping[str, Track], spans: Sequence[Span]) -> dict[str, tuple[Place, Place]]:
    """Aircraft whose position is forged: where each is when that begins, and where it is said to be."""
    begun = {attack: start for start, _, attack in spans}
    found: dict[str, tuple[Place, Place]] = {}
    for attack in _declared(run):
        name = attack["params"].get("vehicle")
        claimed = attack.get("shown", {}).get(f"{name} as claimed")
        track = tracks.get(name)
        if claimed is not None and track is not None and len(track) and attack["id"] in begun:
            east_m, north_m, up_m = track.at(np.array([from_seconds(begun[attack["id"]])]))[0].tolist()
            found[name] = (east_m, north_m, up_m), tuple(claimed)
    return found


def _believed(run: RunRecord, spans: Sequence[Span]) -> dict[str, Track]:
    """Where deceived aircraft believe to be, from the first attack's start on."""
    whom = believing.deceived(run)
    if not whom or not spans:
        return {}
    start_ns = from_seconds(min(start for start, _, _ in spans))
    found = {name: track.since(start_ns) for name, track in believing.beliefs(run, whom).items()}
    return {name: track for name, track in found.items() if len(track)}


def _spans(events: Sequence[Happening], end_s: float) -> list[Span]:
    """When each attack acted: from its start to its stop, or the run's end."""
    begun = {row.about: float(row.data["at_s"]) for row in events if row.kind == "event.attack_start"}
    over = {row.about: float(row.data["at_s"]) for row in events if row.kind == "event.attack_stop"}
    return [(start, over.get(attack, end_s), attack) for attack, start in begun.items()]


def _masthead(pair: Pair) -> str:
    seeds = ", ".join(map(str, pair.seeds))
    facts = [("arms", " · ".join(pair.arms)), ("seed" if len(pair.seeds) == 1 else "seeds", seeds)]
    line = "".join(f"<span>{key} <b>{escape(value)}</b></span>" for key, value in facts)
    return (
        f'<div class="eyebrow">{LOGO}<span>skyrange</span><span class="dim">comparison of twins</span></div>'
        f'<h1>{escape(str(pair.manifest["name"]))}</h1><p class="facts">{line}</p>'
    )


def _tiles(labels: Sequence[Mapping[str, Any]], effects: Sequence[Mapping[str, Any]]) -> str:
    onset = min((row["at_ns"] for row in labels if row["phase"] == "onset"), default=None)
    acts = sum(row["phase"] in ("onset", "act") for row in labels)
    led = [row for row in labels if row["phase"] == "propagation"]
    decided = [row for row in led if row["kind"] != "frame"]
    first = min((row["at_ns"] for row in labels if row["phase"] == "effect"), default=None)
    departed = sum(row["departed_s"] is not None for row in effects)
    delays = [row["delay_s"] for row in effects if row["delay_s"] is not None]
    longer = max((row["extra_distance_m"] for row in effects), key=abs, default=None)
    energy = max((row["extra_energy_j"] for row in effects if row["extra_energy_j"] is not None), key=abs, default=None)
    worse = sum(row["outcome"] != row["outcome_twin"] for row in effects)
    rows = [
        ("onset", words.duration(None if onset is None else onset / NS_PER_S), "the first hostile act"),
        ("hostile acts", words.count(acts), "labelled"),
        ("led to", words.count(len(decided)), f"decisions and events, {words.count(len(led) - len(decided))} frames"),
        ("departed", words.count(departed), f"of {words.count(len(effects))} aircraft"),
        ("first effect", words.duration(None if first is None else first / NS_PER_S), "truth leaves the twin"),
        (
            "delay",
            words.signed(max(delays, key=abs, default=None), "s", 1),
            f"the most; {worse} missions end otherwise",
        ),
        ("extra distance", words.signed(longer, "m", 1), "the most of one aircraft"),
        (
            "extra energy",
            words.signed(None if energy is None else energy / 1000.0, "kJ", 2),
            "the most of one aircraft",
        ),
    ]
    cells = "".join(f"<div><dt>{name}</dt><dd>{value}</dd><dd class=sub>{sub}</dd></div>" for name, value, sub in rows)
    return f'<dl class="tiles">{cells}</dl>'


def _attacks(run: RunRecord, labels: Sequence[Mapping[str, Any]], spans: Sequence[Span]) -> str:
    acted = {attack: (begin, end) for begin, end, attack in spans}
    return words.table(
        "The attacks",
        ["attack", "kind", "parameters", "touches", "ATT&amp;CK for ICS"],
        ["from", "until", "acts"],
        (_attack(row, acted.get(row["id"]), labels) for row in _declared(run)),
    )


def _attack(row: Mapping[str, Any], acted: tuple[float, float] | None, labels: Sequence[Mapping[str, Any]]) -> str:
    count = sum(label["attack"] == row["id"] and label["phase"] in ("onset", "act") for label in labels)
    params = {name: value for name, value in row["params"].items() if value not in ([], {}, "")}
    if row.get("anchor"):
        params["anchor"] = row["anchor"]
    numbers = words.cells(
        words.NONE if acted is None else words.quantity(acted[0], "s", 2),
        words.NONE if acted is None else words.quantity(acted[1], "s", 2),
        words.count(count),
    )
    return (
        f'<tr><th scope=row>{escape(row["id"])}</th><td>{escape(row["kind"])}</td><td class="wrapped">'
        f"{words.details(params)}</td><td>{escape(', '.join(row['touches']))}</td>"
        f"<td>{escape(str(row['technique']))}</td>{numbers}</tr>"
    )


def _effects(subject: Subject, effects: Sequence[Mapping[str, Any]], seed: int, against: str) -> str:
    rows = [row for row in effects if row["seed"] == seed and row["against"] == against]
    said = f'<div class="legend"><span>{escape(_TWINS[against])}</span></div>'
    whom = effecttable.operators(subject, rows)
    whom = f'<div class="card later">{said}{whom}</div>' if whom else ""
    return f'{whom}<div class="card later">{said}{effecttable.effects(subject, rows)}</div>'


def _ensemble(pair: Pair, subject: Subject, effects: Sequence[Mapping[str, Any]]) -> str:
    if len(pair.seeds) < 2:
        return ""
    affected = list(dict.fromkeys(row["vehicle"] for row in effects if row["departed_s"] is not None))
    table = effecttable.ensemble(subject, pair.intervals(), affected)
    return (
        f'<section id="seeds"><h2>Over {len(pair.seeds)} seeds</h2><p class="lead">Attacked minus {pair.reference}, '
        "the mean over the seeds and its 95 % interval by Student's t distribution; bold where it leaves zero out. "
        "Separations are differences too: less than zero is nearer than in the twin.</p>"
        f'<div class="card">{table}</div></section>'
    )


def _hearing(run: RunRecord, subject: Subject, places: Mapping[str, Place]) -> str:
    rows = who_heard_whom(run)
    if not rows:
        return ""
    hostile = receptions_of(run, [row["id"] for row in _declared(run) if row.get("radios")])
    drawing = hearing.hearing_map(subject, hostile, places).svg if len(hostile) else ""
    shown = (
        '<figure class="card"><figcaption><b>Where the attackers were heard</b> <span class="dim">coloured by signal '
        f'strength in dBm; hollow: not decoded</span></figcaption><div class="plan">{drawing}</div></figure>'
        if drawing
        else words.nothing("No broadcast of an attacker reached a receiver.")
    )
    return (
        '<section id="receptions"><h2>Who heard whom</h2><div class="cols">'
        f'{shown}<div class="card">{hearing.hearing_table(rows)}</div></div></section>'
    )


_SNIPPET = """from skyrange.study.pair_folder import load_pair

pair = load_pair(<span class="str">"{path}"</span>)
pair.effects        <span class="rem"># per aircraft, attacked against its twin</span>
pair.labels         <span class="rem"># onset, acts, propagation, effect</span>
pair.intervals()    <span class="rem"># means over seeds with 95 % intervals</span>
pair.run(<span class="str">"attacked"</span>).table(<span class="str">"decisions"</span>)"""
