"""The scene of the viewer's stream: what does not move of one run, or of several that are compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_S
from skyrange.figures.palette import base_colours, theme_colour
from skyrange.figures.subject import subject_of
from skyrange.metrics.approvals import Claim, Prism, read_claims, shown_prisms
from skyrange.metrics.paths import read_waypoints
from skyrange.metrics.time_series import operators, vehicles
from skyrange.record import RunRecord
from skyrange.view.stream.messages import SCENE, VERSION, Array, Message

MAX_CORNERS: Final = 200_000
"""Corners of all buildings that are shown; those nearest to the flights' middle are."""
MAX_VOLUMES: Final = 4_000
"""Claimed volumes that are shown."""
_DM: Final = 10.0


@dataclass(frozen=True)
class ArmRecord:
    """One arm of a comparison, or a run by itself: its id, what people call it, and its record."""

    id: str
    title: str
    record: RunRecord
    ended: str = ""
    """How it ended, where the record was opened before."""

    @property
    def status(self) -> str:
        """How it ended."""
        return self.ended or self.record.status


@dataclass(frozen=True)
class Plans:
    """What the aircraft of one arm are known to plan."""

    waypoints: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    """(n, 3) metres by aircraft, as its autopilot received them."""
    claims: Mapping[str, Sequence[Claim]] = field(default_factory=dict)
    """Claimed airspace by aircraft."""
    items: Mapping[str, Sequence[int]] = field(default_factory=dict)
    """By aircraft, the number of each waypoint's mission item, or -1."""

    @classmethod
    def read(cls, record: RunRecord) -> Plans:
        """Those of a run; none where it has no frames."""
        if not record.keeps("frames"):
            return cls()
        reader = read_waypoints(record)
        return cls(reader.waypoints, read_claims(record), reader.items)


@dataclass(frozen=True)
class Span:
    """The time that a stream shows, ns."""

    start_ns: int
    end_ns: int


def make_scene(
    arms: Sequence[ArmRecord], span: Span, *, name: str, verdict: str = "", plans: Sequence[Plans] | None = None
) -> Message:
    """The scene of some arms, which have the same aircraft, city and operators: those of the first. `plans` are those
    of the arms, which are read from their records unless they are given.
    """
    record = arms[0].record
    subject = subject_of(record)
    inks = {name: list(theme_colour(colour)) for name, colour in base_colours(operators(record)).items()}
    places = {name: place for place, name in enumerate(inks)}
    city, buildings = pack_buildings(record.city, _middle(record))
    head = {
        "version": VERSION,
        "name": name,
        "flying": False,
        "verdict": verdict,
        "operators": [{"id": operator, "ink": ink} for operator, ink in inks.items()],
        "vehicles": [
            {
                "id": vehicle.id,
                "operator": places[vehicle.operator],
                "airframe": vehicle.airframe,
                "ink": list(subject.colours[vehicle.id]),
                "home": [round(value, 2) for value in vehicle.home_enu_m] if vehicle.home_enu_m else None,
            }
            for vehicle in subject.fleet
        ],
        "radios": list_radios(arms),
        "left_out": {"buildings": [len(city["heights"]), buildings]} if len(city["heights"]) < buildings else {},
    }
    known = [Plans.read(arm.record) for arm in arms] if plans is None else plans
    return plan_scene(Message(SCENE, head, city), arms, known, span, shown_until=span.end_ns)


def _count_missions(arm: ArmRecord) -> dict[str, list[int]]:
    """How many missions of a run that has ended are complete, and how many there are."""
    if not arm.record.ended:
        return {}
    states = [(arm.record.outcomes.get(vehicle.id) or {}).get("state") for vehicle in vehicles(arm.record)]
    return {"missions": [states.count("complete"), len(states)]}


def plan_scene(
    scene: Message, arms: Sequence[ArmRecord], plans: Sequence[Plans], span: Span, *, shown_until: int
) -> Message:
    """A scene with the plans of its arms, of the time that `span` has; volumes are shown until a time in ns."""
    volumes, count = _volumes(arms, plans, shown_until)
    points = [np.round(plans[0].waypoints.get(row["id"], np.zeros((0, 3))), 1) for row in scene.head["vehicles"]]
    head = scene.head | {
        "start_s": span.start_ns / NS_PER_S,
        "end_s": span.end_ns / NS_PER_S,
        "arms": [{"id": arm.id, "title": arm.title, "status": arm.status, **_count_missions(arm)} for arm in arms],
        "vehicles": [
            row | {"plan": some.tolist(), "plan_items": list(plans[0].items.get(row["id"], ()))}
            for row, some in zip(scene.head["vehicles"], points, strict=True)
        ],
        "volumes": volumes,
        "left_out": scene.head["left_out"] | ({"volumes": [len(volumes), count]} if len(volumes) < count else {}),
    }
    return Message(SCENE, head, scene.arrays)


def list_radios(arms: Sequence[ArmRecord]) -> list[dict[str, Any]]:
    """Radios that are no aircraft's: ground receivers, and those of attacks. Each has the id of observations."""
    found: dict[str, dict[str, Any]] = {}
    for place, arm in enumerate(arms):
        manifest, here = arm.record.manifest, dict[str, dict[str, Any]]()
        for row in manifest.get("receivers") or ():
            here.setdefault(row["id"], {"id": row["id"], "kind": "receiver", "at": row.get("at_enu_m")})
        for attack in manifest.get("attacks") or ():
            for radio in attack.get("radios") or ():
                owner = str(radio["endpoint"]).rsplit(".", 1)[0]
                here.setdefault(owner, {"id": owner, "kind": "attack", "at": radio.get("at_enu_m")})
        for radio_id, row in here.items():
            found.setdefault(radio_id, row | {"arms": []})["arms"].append(place)
    return list(found.values())


def _volumes(arms: Sequence[ArmRecord], plans: Sequence[Plans], shown_until: int) -> tuple[list[dict[str, Any]], int]:
    """Claimed and closed airspace of all arms, and how many volumes there are."""
    found = []
    for place, (arm, known) in enumerate(zip(arms, plans, strict=True)):
        manifest = arm.record.manifest
        numbers = {str(row["id"]): number for number, row in enumerate(manifest.get("vehicles") or ())}
        for row in manifest.get("constraints") or ():
            begin, end = max(row["start_s"], row["published_s"]), min(row["end_s"], shown_until / NS_PER_S)
            if begin < end:
                times = (round(begin * NS_PER_S), round(end * NS_PER_S))
                closed = Prism(np.array(row["corners_m"], dtype=float), row["lower_m"], row["upper_m"], *times)
                found.append({"arm": place, "vehicle": None, "name": row["id"], **_prism(closed)})
        found += [
            {"arm": place, "vehicle": numbers[vehicle], "name": "", **_prism(prism)}
            for vehicle, prism in shown_prisms(known.claims, shown_until)
            if vehicle in numbers
        ]
    return found[:MAX_VOLUMES], len(found)


def _prism(prism: Prism) -> dict[str, Any]:
    return {
        "from_s": round(prism.start_ns / NS_PER_S, 3),
        "until_s": round(prism.end_ns / NS_PER_S, 3),
        "lower_m": round(prism.lower_m, 1),
        "upper_m": round(prism.upper_m, 1),
        "ring": np.round(prism.ring_m, 1).tolist(),
    }


def _middle(record: RunRecord) -> NDArray[np.float64]:
    homes = [row["home_enu_m"][:2] for row in record.manifest.get("vehicles") or () if row.get("home_enu_m")]
    return np.mean(homes, axis=0) if homes else np.zeros(2)


def pack_buildings(city: Sequence[Mapping[str, Any]], middle: NDArray[np.float64]) -> tuple[dict[str, Array], int]:
    """The arrays of the buildings that are shown, and how many there are."""
    solid = []
    for building in city:
        rings = [_open(np.asarray(ring, dtype=np.float64)[:, :2]) for ring in building.get("rings") or () if len(ring)]
        if rings:
            away_m = float(np.hypot(*(rings[0].mean(axis=0) - middle)))
            solid.append((away_m, float(building.get("height_m") or 0.0), rings))
    solid.sort(key=lambda row: row[0])
    corners = np.cumsum([sum(len(ring) for ring in rings) for _, _, rings in solid])
    shown = solid[: int(np.searchsorted(corners, MAX_CORNERS, side="right"))]
    outlines = [np.diff(np.rint(ring * _DM), axis=0, prepend=0.0) for _, _, rings in shown for ring in rings]
    return {
        "heights": np.array([round(height_m * _DM) for _, height_m, _ in shown], dtype="<i4"),
        "rings": np.array([len(rings) for _, _, rings in shown], dtype="<i4"),
        "corners": np.array([len(ring) for ring in outlines], dtype="<i4"),
        "outlines": np.concatenate([np.zeros((0, 2)), *outlines]).astype("<i4").ravel(),
    }, len(solid)


def _open(ring: NDArray[np.float64]) -> NDArray[np.float64]:
    """An outline without the repeated last corner."""
    return ring[:-1] if len(ring) > 3 and np.allclose(ring[0], ring[-1]) else ring
