"""Measured attacks against DRIP, and measured shares of adopters: tables of `docs/reference/drip-effects.md`.

`python -m tools.docs.measure_drip [attacks|adopters]` flies them and rewrites their sections of the page; without a
name, both. Each attack of `ATTACKS` is flown with `SEEDS`, where the aircraft verifies and records verdicts only, and
with one seed for each defence of `DEFENCES`. The fleet of `adopters` is flown with each share that signs and the same
seeds.
"""

from __future__ import annotations

import re
import sys
import tempfile
from collections.abc import Mapping, Sequence
from json import loads
from pathlib import Path
from statistics import median
from typing import Any, Final, NamedTuple

from skyrange.analysis import remote_id_trust
from skyrange.metrics.aircraft import near_misses
from skyrange.metrics.defences import KIND, LOOK_AHEAD_S
from skyrange.metrics.time_series import read_notes
from skyrange.record import RunRecord
from skyrange.remoteid.broadcast_profiles import sender_address
from skyrange.scenario.toml_files import load_data
from skyrange.study.runs import fly

PAGE: Final = Path(__file__).parents[2] / "docs" / "reference" / "drip-effects.md"
SECTION: Final = "<!-- measured: {0} -->\n{1}<!-- end: {0} -->\n"
SEEDS: Final = (1, 2, 3)
ORIGIN: Final = {"lat": 40.7780, "lon": -73.9550, "alt_msl_m": 20, "geoid_m": -32.7}
START_S: Final = 30.0
DEFENCES: Final = ("drip", "signal", "motion", "appearance", "ground")
"""Kinds of defences without their prefix `remote_id.`."""
NOTICED: Final = frozenset(("stale", "replayed", "refused", "contradicted"))
"""Verdicts by which a receiver sees that something is missing or wrong, beside a sender that never signs."""
POSTS: Final = ([-150, 50, 6], [150, 50, 6], [0, 220, 6], [0, -100, 6], [-80, 180, 6])
"""Receivers on the ground, as in the example of `remote_id.ground`."""
AHEAD: Final = [4, 150, 30]
BESIDE: Final = [30, 120, 2]


class Case(NamedTuple):
    """One attack: its table, without id and times, and what is different in its scenario."""

    kind: str
    params: Mapping[str, Any]
    subject: str = "x"
    """Whose address the verdict is on: the attacker's own, or that of red."""
    start_s: float = START_S
    is_lie: bool = True
    """Whether it says what is false, so that an alarm of a defence would be right."""
    red: Mapping[str, Any] = {}
    """Of the Remote ID of red."""
    verify: Mapping[str, Any] = {}
    """Of the receiver."""


ATTACKS: Final[Mapping[str, Case]] = {
    "insider with a valid key who lies": Case(
        "remote_id.signed_ghost", {"key": "registered", "at": AHEAD, "transmitter_m": BESIDE}
    ),
    "stolen key": Case(
        "remote_id.signed_ghost",
        {"key": "stolen", "vehicle": "red/r1", "at": AHEAD, "transmitter_m": BESIDE},
    ),
    "stolen key, under the victim's address": Case(
        "remote_id.signed_ghost",
        {"key": "stolen", "vehicle": "red/r1", "address": "vehicle", "at": AHEAD, "transmitter_m": BESIDE},
        "red/r1",
    ),
    "made-up registry": Case("remote_id.signed_ghost", {"key": "unregistered", "at": AHEAD, "transmitter_m": BESIDE}),
    "unsigned ghost": Case("remote_id.spoof", {"at": AHEAD, "transmitter_m": BESIDE}),
    "live relay": Case("remote_id.replay", {"delay_s": 0.1, "transmitter_m": BESIDE}, "red/r1"),
    "replay within the validity": Case("remote_id.replay", {"delay_s": 20.0, "transmitter_m": BESIDE}, "red/r1"),
    "registry out of reach": Case("", {}, "red/r1", start_s=0.0, is_lie=False, red={"registry": "unknown"}),
    "page suppression": Case(
        "remote_id.suppress_pages", {"transmitter_m": BESIDE, "power_dbm": 36.0}, "red/r1", is_lie=False
    ),
    "verification flood": Case(
        "remote_id.verification_flood",
        {"transmitter_m": BESIDE, "rate_hz": 200.0},
        "red/r1",
        start_s=0.0,
        is_lie=False,
        verify={"verifications_per_s": 20.0},
    ),
}


def main(names: Sequence[str]) -> None:
    """Fly, measure, and renew the sections of the page."""
    for name in names or ("attacks", "adopters"):
        table = {"attacks": measure_attacks, "adopters": measure_adopters}[name]()
        text = PAGE.read_text(encoding="utf-8")
        pattern = re.compile(SECTION.format(name, ".*?"), re.DOTALL)
        PAGE.write_text(pattern.sub(lambda _: SECTION.format(name, table), text), encoding="utf-8")  # noqa: B023


def measure_attacks() -> str:
    """A row for each attack: what flies it, the verdict on its subject, and the defences that raise an alarm."""
    rows = [
        "| attack | flown by | verdict and its time, s | verdict notices | defences that raise an alarm, s |",
        "|---|---|---|---|---|",
    ]
    for name, case in ATTACKS.items():
        told = [_verdicts(_flown(case, seed), case) for seed in SEEDS]
        noticed = [at for one in told for at in [_noticed_s(one)] if at is not None]
        kinds = DEFENCES if case.is_lie else ()
        alarms = [(kind, _alarm_s(_flown(case, SEEDS[0], kind), case)) for kind in kinds]
        verdicts = "; ".join(f"{state} {at:.1f}" for state, at in told[0]) or "no change"
        raised = ", ".join(f"{kind} {at:.1f}" for kind, at in alarms if at is not None) or ("none" if kinds else "–")
        rows.append(f"| {name} | {_flown_by(case)} | {verdicts} | {_spread(noticed)} | {raised} |")
        print(rows[-1], flush=True)
    return "\n".join(rows) + "\n"


def _spread(times_s: Sequence[float]) -> str:
    if not times_s:
        return "no"
    return f"{min(times_s):.1f} to {max(times_s):.1f} s, {len(times_s)} of {len(SEEDS)}"


def _flown_by(case: Case) -> str:
    shown = {key: value for key, value in case.params.items() if key not in ("at", "transmitter_m", "power_dbm")}
    given = [f"`{key} = {value!r}`" for key, value in {**shown, **case.red, **case.verify}.items()]
    return ", ".join([*([f"`{case.kind}`"] if case.kind else ["no attack"]), *given]).replace("'", '"')


def _flown(case: Case, seed: int, defence: str = "") -> RunRecord:
    signs = {"auth": "drip", "auth_rates": "recommended"}

    def operator(name: str, start: list[float], points: list[list[float]], **more: Any) -> dict[str, Any]:
        plan = {"path": {"points": points, "alt_m": 30}, "speed_mps": 3, "end": "land"}
        return {"id": name, "vehicles": [{"id": f"{name[0]}1", "start": start, "plan": plan}], **more}

    verify = {"verify": {"policy": "accept", "authorities": "all", **case.verify}} if defence != "drip" else {}
    data: dict[str, Any] = {
        "name": "drip-attacks",
        "seed": seed,
        "duration_s": 90.0,
        "origin": ORIGIN,
        "radio": {
            "receivers": [
                {"id": f"post{number}", "operator": "blue", "place": place} for number, place in enumerate(POSTS)
            ]
        },
        "operators": [
            operator("blue", [0, 0], [[0, 0], [0, 150]], remote_id={**signs, **verify}),
            operator("red", [50, 20], [[0, 0], [0, 150]], remote_id={**signs, **case.red}),
        ],
    }
    if case.kind:
        data["attacks"] = [{"id": "x", "kind": case.kind, "start_s": case.start_s, "params": dict(case.params)}]
    if defence:
        given = {"vehicles": ["blue/b1"], "authorities": "all", **case.verify} if defence == "drip" else {}
        data["defences"] = [{"id": defence, "kind": f"remote_id.{defence}", "params": given}]
    return _fly(data)


def _fly(data: dict[str, Any]) -> RunRecord:
    folder = Path(tempfile.mkdtemp(dir=FOLDER))
    return fly(load_data(data), folder / "run", report=False)


def _verdicts(run: RunRecord, case: Case) -> list[tuple[str, float]]:
    """The changes of blue's verdict on the subject from the attack's start on, in seconds after it."""
    address = sender_address(case.subject).hex()
    return [
        (str(note.data["state"]), round(note.time_ns / 1e9 - case.start_s, 1))
        for note in read_notes(run, "events")
        if note.kind == KIND and note.about == "blue/b1" and note.data["address"] == address
        if note.time_ns / 1e9 >= case.start_s
    ]


def _noticed_s(verdicts: Sequence[tuple[str, float]]) -> float | None:
    """When the first verdict came by which the receiver noticed something: a bad one, or none to the end."""
    found = next((at for state, at in verdicts if state in NOTICED), None)
    if found is None and verdicts and verdicts[-1][0] == "none":
        return verdicts[-1][1]
    return found


def _alarm_s(run: RunRecord, case: Case) -> float | None:
    """When the first alarm about the subject after the attack's start came, in seconds after it."""
    address = sender_address(case.subject).hex()
    rows = run.table("alerts", ["time_ns", "data"]).to_pylist()
    times = [row["time_ns"] / 1e9 for row in rows if loads(row["data"]).get("address") == address]
    return min((at - case.start_s for at in times if at >= case.start_s), default=None)


def measure_adopters() -> str:
    """A row for each share of eight aircraft that sign: four pairs meet head-on, and ignore who does not."""
    rows = [
        "| share that signs | trusted pairs of signing senders | in 12 s | median, s | avoidances | near misses |",
        "|---|---|---|---|---|---|",
    ]
    for adopters in (0, 2, 4, 6, 8):
        runs = [_fly(_fleet(adopters, seed)) for seed in SEEDS]
        signed = [pair for run in runs for pair in remote_id_trust(run).signed]
        times = [time_s for pair in signed if (time_s := pair.time_to_trust_s) is not None]
        avoidances = [sum(note.kind == "decision.avoid" for note in read_notes(run, "decisions")) for run in runs]
        missed = [len(near_misses(run)) // 2 for run in runs]
        rows.append(
            f"| {100 * adopters // 8} % | {len(times)} of {len(signed)} | "
            f"{sum(time_s <= LOOK_AHEAD_S for time_s in times)} | {f'{median(times):.1f}' if times else '–'} | "
            f"{_each(avoidances)} | {_each(missed)} |"
        )
        print(rows[-1], flush=True)
    return "\n".join(rows) + "\n"


def _each(counts: Sequence[int]) -> str:
    return ", ".join(str(count) for count in counts)


def _fleet(adopters: int, seed: int) -> dict[str, Any]:
    """Four streets, 60 m apart; in each, two aircraft start 200 m apart and meet. Those of one side adopt first."""
    operators = []
    for number in range(8):
        street, southward = number % 4, number >= 4
        verify: dict[str, Any] = {"policy": "ignore-unsigned", "authorities": "all"}
        signs: dict[str, Any] = {"auth": "drip", "auth_rates": "recommended"} if number < adopters else {}
        step = -200 if southward else 200
        plan = {"path": {"points": [[0, 0], [0, step]], "alt_m": 30}, "speed_mps": 5, "end": "land"}
        start = [60 * street + (2 if southward else 0), 200 if southward else 0]
        vehicle = {"id": "v1", "start": start, "plan": plan}
        operators.append(
            {
                "id": f"o{number}",
                "avoidance": "geometric",
                "remote_id": signs | {"verify": verify},
                "vehicles": [vehicle],
            }
        )
    return {
        "name": "adopters", "seed": seed, "duration_s": 90.0, "origin": ORIGIN, "radio": {}, "operators": operators,
    }  # fmt: skip


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        FOLDER = Path(name)
        main(sys.argv[1:])
