"""Honest arm: real aircraft on the tracks that attacks claim, their radios, and which claims no aircraft can keep."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from skyrange.assembly.radio import uas_id_of
from skyrange.attack.contract import Attack, Transmitter
from skyrange.city.city import City
from skyrange.contracts.claims import ClaimedTrack
from skyrange.core.elementary_python import hypot3
from skyrange.core.errors import Problem
from skyrange.core.ids import owner_of, vehicle_id
from skyrange.scenario.model.attacks import ActTable, AttackTable
from skyrange.scenario.model.scenario import Scenario
from skyrange.vehicle.claimed_tracks import PARKED_M, SPACING_M, HonestBody
from skyrange.world import Body
from skyrange.world.airframes import AIRFRAMES

AIRFRAME: Final = "iris"
"""Airframe of a claimed aircraft whose UAS ID no aircraft of the scenario has."""
STEP_M: Final = 1.0
"""Distance between the points of a claimed track that are looked up in the city."""
MAX_STEPS: Final = 100_000


@dataclass(frozen=True, slots=True)
class HonestAircraft:
    """A real aircraft of the honest arm, and the attack whose claim it keeps."""

    attack: str
    body: HonestBody

    @property
    def vehicle(self) -> str:
        """Its id in truth."""
        return self.body.vehicle


def is_honest(attack: ActTable) -> bool:
    """Whether an attack is declared to run its honest arm."""
    return isinstance(attack, AttackTable) and attack.honest


def find_claim_problems(
    where: str, attack: AttackTable, made: Attack, scenario: Scenario, city: City | None
) -> Iterator[Problem]:
    """Why an attack has no honest arm, and what of its claims no real aircraft can keep."""
    if not attack.plugin.honest:
        expected = f"false, because {attack.kind} names no aircraft that is not there"
        yield Problem(f"{where}.honest", "true", expected, "remote_id.spoof is a kind that does.")
    elif not made.claims:
        expected = "parameters with which it sends from a radio of its own, which a real aircraft can carry"
        yield Problem(f"{where}.honest", "true", expected, 'Of remote_id.spoof: via = "radio".')
    longest = scenario.duration_s - attack.start_s
    if attack.stop_s is not None:
        longest = min(longest, attack.stop_s - attack.start_s)
    if attack.for_s is not None:
        longest = min(longest, attack.for_s)
    for claim in made.claims:
        yield from _find_unflyable(f"{where}.params", claim, max(longest, 0.0), scenario, city)


def _find_unflyable(
    where: str, claim: ClaimedTrack, longest_s: float, scenario: Scenario, city: City | None
) -> Iterator[Problem]:
    name = airframe_of(claim, scenario)
    airframe = AIRFRAMES[name]
    wind = scenario.wind.air.steady_enu_mps
    east, north, up = (v - w for v, w in zip(claim.velocity_mps, wind, strict=True))
    needed_n, most_n = airframe.thrust_for(east, north, up), airframe.max_thrust_n
    shown = f"[{', '.join(f'{v:g}' for v in claim.velocity_mps)}] m/s"
    if needed_n > most_n:
        air = f"{hypot3(east, north, up):.1f} m/s through the air need {needed_n:.1f} N of thrust"
        expected = f"a velocity that a real {name} can keep; {air}, and it has {most_n:.1f} N"
        yield Problem(f"{where}.velocity_mps", shown, expected, "Claim a lower speed, or compare without --honest.")
    far_m = hypot3(*claim.velocity_mps) * longest_s
    steps = min(max(int(far_m / STEP_M), 1), MAX_STEPS) if far_m else 0
    for step in range(steps + 1):
        seconds = longest_s * step / steps if steps else 0.0
        place = claim.at(seconds)
        building = city.inside(*place) if city is not None else None
        if building is None and place[2] >= 0.0:
            continue
        inside = "below the ground" if building is None else f"inside {building.name or building.id}"
        value = f"[{', '.join(f'{x:.1f}' for x in place)}] m, {seconds:.1f} s after the start"
        yield Problem(f"{where}.at", value, f"a track that a real aircraft can fly; this point is {inside}")
        return


def airframe_of(claim: ClaimedTrack, scenario: Scenario) -> str:
    """The airframe of the aircraft whose UAS ID is claimed, or `AIRFRAME`."""
    for operator, vehicle in scenario.fleet:
        if uas_id_of(vehicle_id(operator.id, vehicle.id), vehicle, scenario) == claim.uas_id:
            return vehicle.airframe
    return AIRFRAME


def carried(radios: Sequence[Transmitter], claims: Sequence[ClaimedTrack]) -> list[Transmitter]:
    """The radios of an attack; those that real aircraft carry are where these are."""
    aboard = {claim.radio for claim in claims}
    return [replace(radio, at_enu_m=None) if radio.endpoint in aboard else radio for radio in radios]


def park(aircraft: Sequence[HonestAircraft], scenario: Scenario, run: int) -> tuple[list[Body], list[HonestBody]]:
    """The bodies before their attacks start, as those of run number `run` of a batch, and what moves each."""
    bodies, moved = [], []
    for row, honest_aircraft in enumerate(aircraft):
        east_m, north_m, _ = honest_aircraft.body.track.start_enu_m
        up_m = PARKED_M + row * SPACING_M
        bodies.append(
            Body(
                vehicle=honest_aircraft.vehicle,
                airframe=airframe_of(honest_aircraft.body.track, scenario),
                east_m=east_m,
                north_m=north_m,
                up_m=up_m,
                present=False,
                run=run,
                seed=scenario.seed,
            )
        )
        moved.append(replace(honest_aircraft.body, parked_m=up_m, run=run))
    return bodies, moved


def describe_aircraft(aircraft: Sequence[HonestAircraft], scenario: Scenario) -> list[Mapping[str, Any]]:
    """What the manifest says of them as `honest`."""
    return [
        {
            "id": honest_aircraft.vehicle,
            "attack": honest_aircraft.attack,
            "uas_id": honest_aircraft.body.track.uas_id,
            "airframe": airframe_of(honest_aircraft.body.track, scenario),
            "start_enu_m": list(honest_aircraft.body.track.start_enu_m),
            "velocity_mps": list(honest_aircraft.body.track.velocity_mps),
        }
        for honest_aircraft in aircraft
    ]


def aircraft_of(attack: ActTable, made: Attack, schedule: Any) -> list[HonestAircraft]:
    """The real aircraft of an attack."""
    return [HonestAircraft(attack.id, HonestBody(owner_of(claim.radio), claim, schedule)) for claim in made.claims]
