"""Agreement of a live range with the run in virtual time: every shipped scenario, compared as `skyrange diff` does.

`python -m tests.integration.live_agrees [NAME …] [--out FOLDER]` flies them in real time and prints a table; with
`--virtual` the live ranges too are in virtual time, on transports in memory.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from skyrange.metrics.agreement import Agreement, KindAgreement, agreement
from skyrange.record import RunRecord, load
from skyrange.runtime.live.deployment import Group
from skyrange.runtime.live.range import prepare_range
from skyrange.runtime.live.supervisor.supervisor import run_range
from skyrange.runtime.live.system import System
from skyrange.runtime.run import Run
from skyrange.scenario.shipped import load as load_scenario
from tests.integration.live_virtual import JITTER_S
from tests.live_ranges import VirtualNetwork, VirtualSystem

TOLERANCE_S: Final = 1.5
"""Of every note. Uploads are some thirty questions and answers, each through three programs that look at their mail 50
or 100 times a second: a millisecond too late is a whole turn later. And a ground station knows of progress from
MISSION_CURRENT, which comes once a second from whenever it was asked for."""
RACES: Final[Mapping[str, str]] = {
    "decision.progress": "an item of less than a second is seen, or not, in a message that comes once a second",
    "decision.avoid": "the same leg, chosen a quarter of a second later, when one track more or fewer is heard",
    "event.track_lost": "by chance, which depends on the time of sending, a receiver hears a weak sender",
    "event.track_seen": "the same",
    "event.remote_id": "whether the first broadcast, at 1 s, comes before or after the first position",
}
"""What may be in one run alone, and why."""


@dataclass(frozen=True, slots=True)
class Flight:
    """How long a scenario is flown here: until its last aircraft has ended its mission."""

    seconds: float
    off_m: float = 1.0
    """What an aircraft may be off its way of virtual time, a second and a half sooner or later."""
    group: Group | None = None
    only_outcomes: bool = False
    """For one that a millisecond makes another: then the missions' outcomes are all that has to agree."""


FLIGHTS: Final[Mapping[str, Flight]] = {
    "squares": Flight(60.0),
    "survey": Flight(185.0),
    "city-fleet": Flight(230.0, group="operator"),
    # which broadcast makes either turn away first is chance, addressed by the time at which it was sent
    "chain": Flight(160.0, group="one", only_outcomes=True),
    # which of two requests for one corridor comes first is chance of microseconds, and so is who gets an alternative
    "corridor-rush": Flight(1740.0, group="operator", only_outcomes=True),
    "crossing": Flight(140.0),
    "head-on": Flight(50.0),
    # it departs when it is ready, the attack begins by the clock: that finds it up to 5 m from where it would be
    "gnss-drift": Flight(80.0, off_m=8.0),
    # forty that evade each other: which broadcast comes through is chance, addressed by the time at which it was sent
    "rid-city": Flight(300.0, group="operator", only_outcomes=True),
    "rid-spoofing": Flight(155.0),
    # when either receives the other's Links is chance, addressed by the time of sending
    "unsigned-ghost": Flight(200.0, only_outcomes=True),
    "wind": Flight(160.0),
    "mitm-mission": Flight(130.0),
    # which scans make a look is chance of microseconds, and so is where it lands
    "emergency-landing": Flight(85.0, only_outcomes=True),
    "falsified-log": Flight(145.0, off_m=4.0),
    # which heartbeats a full queue loses is chance of microseconds, and so is when the failsafe acts
    "gcs-flood": Flight(150.0, only_outcomes=True),
    "hijack": Flight(130.0, group="one"),
    # when either hears the other over Bluetooth is chance, addressed by the time of sending
    "jammed-corridor": Flight(125.0, only_outcomes=True),
    "gnss-pull-off": Flight(130.0),
    "insider": Flight(60.0, group="operator"),
    # after the capture a crash follows from centimetres
    "jam-then-spoof": Flight(112.0, only_outcomes=True),
}


@dataclass(frozen=True, slots=True)
class Both:
    """One scenario, flown both ways."""

    name: str
    live: RunRecord
    found: Agreement

    @property
    def facts(self) -> Mapping[str, Any]:
        return dict(self.live.manifest["live"])

    @property
    def off_m(self) -> float:
        return max((way.off_m for way in self.found.ways.values()), default=0.0)

    @property
    def wrong(self) -> list[str]:
        """What is beyond what is allowed."""
        flight = FLIGHTS[self.name]
        said = [f"{vehicle}: {mine} | {other}" for vehicle, (mine, other) in self.found.outcomes.items()]
        if flight.only_outcomes:
            return said
        said += [str(odd) for odd in self.found.odd if odd.kind not in RACES]
        if self.off_m > flight.off_m:
            said.append(f"{self.off_m:.1f} m off the way, at most {flight.off_m:g} m")
        return said

    def amount_s(self, prefix: str = "", but: tuple[str, ...] = ()) -> float:
        """The most that notes of the kinds were apart in time."""
        kinds: list[KindAgreement] = [
            kind for name, kind in self.found.kinds.items() if name.startswith(prefix) and name not in but
        ]
        return max((max(abs(kind.least_s), abs(kind.most_s)) for kind in kinds), default=0.0)


def fly_both(
    name: str, folder: Path, port_offset: int = 0, seconds: float | None = None, system: System | None = None
) -> Both:
    """Fly a shipped scenario as a live range, on this machine or on `system`, and as a run, into `folder`."""
    flight = FLIGHTS[name]
    scenario = load_scenario(name, [f"duration_s={seconds or flight.seconds}"])
    flown = prepare_range(scenario, folder / "live", group=flight.group, port_offset=port_offset, system=system)
    run_range(flown)
    Run.start(scenario, folder / "virtual").execute()
    return compared(name, folder / "live", folder / "virtual")


def virtual(seed: int = 0) -> VirtualSystem:
    """A system in virtual time whose network is as late as a machine's."""
    return VirtualSystem(network=VirtualNetwork(jitter_s=JITTER_S, seed=seed))


def compared(name: str, live: Path, virtual: Path) -> Both:
    """What two runs of a shipped scenario make."""
    record = load(live)
    return Both(name, record, agreement(record, load(virtual), TOLERANCE_S))


def row(both: Both) -> str:
    """Of the table in docs/explanation/live.md."""
    found = both.found
    flying = [both.amount_s(kind) for kind in ("event.item_reached", "event.landed", "event.collision")]
    odd = [f"{one.kind.partition('.')[2]} of {one.about}" for one in found.odd]
    late_s = max(both.facts["late_max_s"].values())
    cells = (
        f"`{both.name}`",
        f"{found.until_s:.0f} s",
        str(len(both.facts["nodes"])),
        str(sum(kind.found for kind in found.kinds.values())),
        "none" if not odd else f"{len(odd)}: {', '.join(sorted(set(odd))[:2])}{' …' if len(set(odd)) > 2 else ''}",
        f"{both.amount_s('decision.uploaded'):.2f} s",
        f"{both.amount_s('decision.progress'):.2f} s",
        f"{max(flying):.2f} s",
        f"{both.off_m:.2f} m",
        "the same" if not found.outcomes else f"{len(found.outcomes)} differ",
        f"{late_s:.2f} s",
    )
    return f"| {' | '.join(cells)} |"


HEAD = (
    "| scenario | until | processes | notes in both | in one alone | upload ends | progress | items, landings, "
    "collisions | off the way | outcomes | behind at most |\n|---|---|---|---|---|---|---|---|---|---|---|"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(FLIGHTS)}; default: all")
    parser.add_argument("--out", type=Path, help="keep the runs in this folder, and take those that are there")
    parser.add_argument("--port-offset", type=int, default=0)
    parser.add_argument("--virtual", action="store_true", help="fly the live ranges in virtual time")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as kept:
        folder = asked.out or Path(kept)
        print(HEAD, flush=True)
        for name in asked.names or FLIGHTS:
            if (folder / name / "virtual").exists():
                both = compared(name, folder / name / "live", folder / name / "virtual")
            else:
                both = fly_both(name, folder / name, asked.port_offset, system=virtual() if asked.virtual else None)
            print(row(both), flush=True)
            for line in both.wrong:
                print(f"    {line}", flush=True)


if __name__ == "__main__":
    main()
