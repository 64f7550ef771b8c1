"""A companion in a kernel with autopilots and ground stations; by radio everybody hears everybody."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
import shapely

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.codec import f3411
from skyrange.codec.mavlink import Packer, decode
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.remote_id import link_payload
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.verdicts import Inject, Verdict
from skyrange.core.time import NS_PER_S, Time
from skyrange.kernel import Kernel
from skyrange.remoteid.broadcast_profiles import serial_number
from skyrange.vehicle.avoidance.contract import Avoidance
from skyrange.vehicle.avoidance.geometric import Geometric
from skyrange.vehicle.avoidance.none import NoAvoidance
from tests.integration.companion_range import Flown, Ghost, Notes, legs, wired

pytestmark = pytest.mark.rotating

A = "blue/b1"
HOME = (-100.0, 0.0, 0.0)
LEG = ((-100.0, 0.0, 30.0), (100.0, 0.0, 30.0))
RED = Ghost("red", (0.0, 0.0, 30.0), 0.0, 60.0)
AVOIDING = ("decision.avoid", "decision.resume", "decision.yield", "decision.avoid_refused", "decision.avoid_return")


def passage() -> City:
    """Two buildings, and 24 m between them."""
    boxes = [(-30, 12, 30, 72), (-30, -72, 30, -12)]
    return City([Building(str(i), 60.0, shapely.box(*box)) for i, box in enumerate(boxes)], "test")


def one(avoidance: Any = Geometric, **options: Any) -> Flown:
    return wired({A: (HOME, legs(HOME, *LEG))}, avoidance, passage(), **options)


@cache
def nominal() -> Flown:
    return one().run(75)


@cache
def attacked() -> Flown:
    return one(ghosts=(RED,)).run(142)


def commands(flown: Flown) -> list[tuple[float, Any, Frame]]:
    """What the companion told the autopilot, but for what it asks it to tell."""
    found = []
    for frame in flown.notes.frames:
        if frame.link == f"log:{A}" and frame.direction == "fwd":
            message = decode(frame.payload)
            if message.get_srcComponent() != 191 or message.get_type() == "OPEN_DRONE_ID_ARM_STATUS":
                continue
            if getattr(message, "command", 0) != mav.MAV_CMD_SET_MESSAGE_INTERVAL:
                found.append((frame.sent_ns / NS_PER_S, message, frame))
    return found


def middle(flown: Flown) -> np.ndarray:
    """Where it was while between the buildings' ends, on its way out."""
    path = flown.path(0)
    out = path[: np.argmax(path[:, 1])]
    return np.asarray(out[np.abs(out[:, 1]) < 25.0])


def test_without_anybody_in_the_way_the_passage_is_flown_and_nothing_commanded() -> None:
    flown = nominal()
    assert flown.notes.kinds_of(A, *AVOIDING) == []
    assert commands(flown) == []
    assert np.abs(middle(flown)[:, 2]).max() < 2.0
    assert flown.path(0)[:, 1].max() > 95.0


def test_a_ghost_in_the_passage_turns_it_away_and_the_mission_goes_on() -> None:
    flown = attacked()
    kinds = [kind for _, kind in flown.notes.kinds_of(A, *AVOIDING)]
    assert kinds[0] == "decision.avoid"
    assert kinds[-1] == "decision.resume"
    assert set(kinds) == {"decision.avoid", "decision.resume"}
    assert np.abs(middle(flown)[:, 2]).min() > 72.0  # around the building, not along its wall
    assert flown.path(0)[:, 1].max() > 95.0
    for _, east, north, up in flown.path(0).tolist():
        assert passage().inside(east, north, up) is None


def test_decisions_and_commands_quote_the_forged_frames() -> None:
    flown = attacked()
    forged = {
        frame.id for frame in flown.notes.frames
        if frame.link == f"rid_down:{A}" and serial_number("red").encode() in frame.payload
    }  # fmt: skip
    assert forged
    first = next(s.note for s in flown.notes.spoken if s.note.kind == "decision.avoid")
    assert first.data["track"] == serial_number("red")
    for spoken in flown.notes.spoken:
        if spoken.note.kind in AVOIDING:
            assert spoken.note.causes
            assert set(spoken.note.causes) <= forged
    told = commands(flown)
    assert [m.get_type() for _, m, _ in told[:3]] == ["COMMAND_LONG"] * 2 + ["SET_POSITION_TARGET_GLOBAL_INT"]
    assert all(set(frame.causes) <= forged and frame.causes for _, _, frame in told)
    modes = [s.note for s in flown.notes.spoken if s.note.kind == "event.mode" and s.note.data["mode"] == "GUIDED"]
    # the autopilot's change of mode was caused by the companion's command as it arrived there
    cause = {frame.id: frame for frame in flown.notes.frames}[modes[-1].causes[0]]
    assert decode(cause.payload).get_srcComponent() == 191


def test_the_ground_station_tolerates_the_detour() -> None:
    flown = attacked()
    bad = {"decision.gave_up", "decision.failed", "decision.link_lost", "decision.bad_frame", "decision.foreign_frame"}
    assert not {s.note.kind for s in flown.notes.spoken} & bad
    assert flown.station.outcomes[A].state == "complete"


def test_before_the_ghost_appears_the_twins_are_the_same() -> None:
    late = one(ghosts=(Ghost("red", RED.enu_m, 24.0, 60.0),)).run(24.0 - 1e-6)
    clean = one(ghosts=(Ghost("red", RED.enu_m, 1e6),)).run(24.0 - 1e-6)
    assert late.notes.digests.frames == clean.notes.digests.frames


def test_what_is_broadcast_is_what_it_believes_each_second() -> None:
    flown = nominal()
    times = [at for at, _, _ in flown.oracle.heard]
    assert len(times) > 70
    assert max(np.diff(times)) <= 1.011 * NS_PER_S
    path = flown.path(0)
    for at, sender, payload in flown.oracle.heard[5:]:
        assert sender == A
        said = f3411.decode(link_payload.unpack(payload).body)
        assert f3411.deviations(said) == ()
        assert isinstance(said, f3411.MessagePack)
        basic, location, system = said.messages
        assert isinstance(basic, f3411.BasicId)
        assert isinstance(location, f3411.Location)
        assert isinstance(system, f3411.System)
        assert basic.uas_id == serial_number(A)
        true = path[np.argmin(np.abs(path[:, 0] - at / NS_PER_S))]
        assert location.lat_deg is not None
        assert location.lon_deg is not None
        east, north = flown.companion._origin.enu_of(location.lat_deg, location.lon_deg)
        # 8 m/s, and told up to 0.25 s before it is sent and 10 ms before it is heard
        assert np.hypot(east - true[1], north - true[2]) < 3.0
    airborne = [f3411.decode(link_payload.unpack(p).body).messages[1].status for _, _, p in flown.oracle.heard]  # type: ignore[union-attr]
    assert airborne[2] == f3411.Status.GROUND
    assert f3411.Status.AIRBORNE in airborne


def test_two_who_meet_head_on_pass_each_other_and_both_complete() -> None:
    ends = {A: (-120.0, 0.0, 0.0), "blue/b2": (120.0, 0.0, 0.0)}
    plans = {
        name: (home, legs(home, (home[0], 0.0, 40.0), (-home[0], 30.0 if home[0] > 0 else 0.0, 40.0)))
        for name, home in ends.items()
    }

    def least(avoidance: Any) -> tuple[float, Flown]:
        flown = wired(plans, avoidance).run(50)
        apart = [
            float(np.hypot(*(places[0] - places[1])[:2]))
            for at, places in flown.notes.track
            if min(places[:, 2]) > 20.0
        ]
        return min(apart), flown

    apart, flown = least(Geometric)
    assert apart > 19.0  # protected_m is 20
    assert all("decision.resume" in dict(map(reversed, flown.notes.kinds_of(v, *AVOIDING))) for v in ends)  # type: ignore[arg-type]
    assert least(NoAvoidance)[0] < 19.0


class Operator:
    """A tap that has the ground station choose another mode, once."""

    def __init__(self, link: str, at_s: float, mode: int) -> None:
        self.at: Time | None = round(at_s * NS_PER_S)
        self.mode = mode

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        return ()

    def next_wakeup(self) -> Time | None:
        return self.at

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        self.at = None
        message = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_DO_SET_MODE, 0, 1, self.mode, 0, 0, 0, 0, 0)
        return [Inject(Packer(255, 190).pack(message), "fwd", "blue.gcs", f"{A}.companion")]


def with_operator(at_s: float, mode: int, seconds: float, **options: Any) -> Flown:
    flown = one(ghosts=(RED,), **options)
    flown.wiring.taps = [TapPlacement(f"gcs:{A}", "gcs", lambda link: Operator(link, at_s, mode))]
    notes = Notes()
    return Flown(Kernel(flown.wiring, [notes]), notes, flown.companion, flown.oracle, flown.station, flown.wiring).run(
        seconds
    )


def test_an_operator_who_chooses_another_mode_is_obeyed() -> None:
    begun = attacked().notes.kinds_of(A, "decision.avoid")[0][0]
    flown = with_operator(begun + 4.0, mav.COPTER_MODE_LOITER, begun + 25.0)
    kinds = flown.notes.kinds_of(A, *AVOIDING)
    assert kinds[-1][1] == "decision.yield"
    assert begun + 4.0 < kinds[-1][0] < begun + 5.6  # a heartbeat shows it, and it looks every 0.25 s
    assert [at for at, _, _ in commands(flown) if at > kinds[-1][0]] == []
    modes = [s.note.data["mode"] for s in flown.notes.spoken if s.note.kind == "event.mode"]
    assert modes[-1] == "LOITER"


def test_remote_id_that_is_not_serviceable_keeps_it_on_the_ground() -> None:
    """14 CFR 89.310(c)(2), where DID_ENABLE and bit 0 of DID_OPTIONS ask for it."""
    params = {"DID_ENABLE": 1.0, "DID_OPTIONS": 1.0}
    silent = one(params=params, broadcast={"transports": ()}).run(30)
    assert silent.path(0)[:, 3].max() < 0.1
    words = [m.text for m in said(silent, "STATUSTEXT")]
    assert any("OpenDroneID: no transmitter" in text for text in words)
    good = one(params=params).run(20)
    assert good.path(0)[:, 3].max() > 5.0
    free = one(broadcast={"transports": ()}).run(20)  # the default, as ArduPilot's
    assert free.path(0)[:, 3].max() > 5.0
    assert free.oracle.heard == []


def said(flown: Flown, kind: str) -> list[Any]:
    found = [decode(f.payload) for f in flown.notes.frames if f.link == f"autopilot:{A}" and f.direction == "rev"]
    return [message for message in found if message.get_type() == kind]


def test_a_fork_goes_on_alike_and_so_does_a_fleet_with_two_companions() -> None:
    whole = attacked()
    stem = one(ghosts=(RED,)).run(30)
    notes = Notes()
    twin = stem.kernel.fork([notes])
    twin.advance(45 * NS_PER_S)
    stem.run(45)
    after = [(s.at_s, s.note) for s in stem.notes.spoken if s.at_s > 30.0]
    assert after == [(s.at_s, s.note) for s in notes.spoken]
    assert len([1 for _, note in after if note.kind.startswith("decision.")]) > 0
    assert [s.note for s in whole.notes.spoken if 30 < s.at_s <= 45] == [note for _, note in after]


def test_companions_of_many_say_what_companions_of_one_say() -> None:
    homes = {f"blue/b{i}": (-100.0 + 60.0 * i, 20.0 * i, 0.0) for i in range(1, 4)}
    plans = {v: (home, legs(home, (home[0], home[1], 30.0), (0.0, 0.0, 30.0))) for v, home in homes.items()}

    def frames(split: bool) -> Any:
        flown = wired(plans, _shared)
        if split:
            from skyrange.core.chance import Chance
            from skyrange.vehicle.companion import Companion

            others = [agent for agent in flown.wiring.agents if agent.name != "companions"]
            parts = [
                Companion(f"companion {spec.vehicle}", [spec], flown.companion._origin, Chance(3))
                for spec in flown.companion.specs
            ]
            flown.wiring.agents = [*others, *parts]
        notes = Notes()
        Kernel(flown.wiring, [notes]).advance(30 * NS_PER_S)
        decided = [s.note for s in notes.spoken if s.note.kind in AVOIDING]
        return notes.digests.frames, sorted(decided, key=repr)

    together, apart = frames(False), frames(True)
    assert together == apart
    assert together[1]


_ONE = Geometric()


def _shared(city: City | None) -> Avoidance:
    return _ONE
