"""Do kinds that consist of one common act do what it says: on frames, on fields of messages and on readings?"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import pytest

import skyrange.plugin as sky
from skyrange.codec.mavlink import Packer, decode, dialect
from skyrange.contracts.components import Sensors
from skyrange.contracts.verdicts import Delay, Drop, Inject, Replace
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S, NS_PER_US, Time
from tests.registered_kinds import registered
from tests.unit.test_attack_gnss import context as sensor_context
from tests.unit.test_attack_gnss import fault, readings
from tests.unit.test_attack_link import ENDS, LINK, PACKER, POSITION, context, frame, woken

S = NS_PER_S

with registered():

    @sky.attack("test.drops", technique="T0814")
    class Drops(sky.OnPath):
        """Drops frames."""

        act = sky.drop(0.5)

    @sky.attack("test.delays", technique="T0830")
    class Delays(sky.OnPath):
        """Delays frames."""

        delay_s: sky.Number = sky.param("Delay in seconds.", default=1.0, gt=0)
        act = sky.delay("delay_s", 0.5)

    @sky.attack("test.duplicates", technique="T0830")
    class Duplicates(sky.OnPath):
        """Copies frames."""

        copies: sky.Whole = sky.param("Number of copies.", default=2, ge=1)
        act = sky.duplicate("copies", 0.25)

    @sky.attack("test.climbs", technique="T0856")
    class Climbs(sky.OnMessages):
        """Adds to a height."""

        by_mm: sky.Number = sky.param("Added millimetres.", default=1_500.4)
        alter = sky.alter_field("relative_alt", "by_mm")

    @sky.attack("test.mirrors", technique="T0856")
    class Mirrors(sky.OnMessages):
        """Turns a climb into a descent."""

        alter = sky.alter_field("vz", lambda self, value: -value)

    @sky.attack("test.freezes", technique="T0856")
    class Freezes(sky.OnMessages):
        """Keeps a latitude."""

        alter = sky.hold_field("lat")

    @sky.attack("test.tells", technique="T0856")
    class Tells(sky.OnMessages):
        """Writes into texts."""

        alter = sky.alter_field("text", lambda self, value: value.upper())

    @sky.attack("test.lifts", surface=("baro",))
    class Lifts(sky.OnSensors):
        """Adds to the height of the barometer."""

        by_m: sky.Number = sky.param("Added metres.", default=4.0)
        act = sky.alter_reading("baro_up_m", "by_m")

    @sky.attack("test.blinds", surface=("gnss",))
    class Blinds(sky.OnSensors):
        """Halves the satellites."""

        act = sky.alter_reading("gnss_satellites", lambda self, values: values * 0.4)

    @sky.attack("test.sticks", surface=("baro",))
    class Sticks(sky.OnSensors):
        """Keeps the height of the barometer."""

        act = sky.hold_reading("baro_up_m")


def tap_of(kind: Any, start_s: float = 0.0, sham: bool = False, **params: Any) -> Any:
    chosen = kind.params_model.model_validate({"links": [LINK], **params})
    (placement,) = kind.plugin(chosen, context(start_s, sham)).taps
    return placement.make(LINK)


@pytest.mark.parametrize("kind", [Drops, Delays, Duplicates, Climbs, Freezes])
@pytest.mark.parametrize("now", [5 * S - 1, 9 * S])
def test_frames_pass_before_the_start_and_after_the_end(kind: Any, now: Time) -> None:
    tap = tap_of(kind, start_s=5.0)
    tap.schedule.stop_ns = 9 * S
    assert all(not tap.on_frame(now, frame(number)) for number in range(20))
    assert tap.next_wakeup() is None
    assert any(tap.on_frame(5 * S, frame(number)) or tap.next_wakeup() for number in range(20))


@pytest.mark.parametrize("sham", [False, True])
def test_a_share_is_dropped_in_a_sham_as_well(sham: bool) -> None:
    tap = tap_of(Drops, sham=sham)
    verdicts = [tap.on_frame(0, frame(number)) for number in range(200)]
    assert set(verdicts) == {(), (Drop(),)}
    assert 70 < verdicts.count(()) < 130
    assert tap_of(Drops, sham=not sham).on_frame(0, frame(7)) == verdicts[7]


def test_a_delay_has_its_range_and_order_and_a_sham_a_microsecond() -> None:
    tap = tap_of(Delays, delay_s=2.0)
    untils = [tap.on_frame(number, frame(number))[0].until for number in range(50)]
    assert untils == sorted(untils)
    assert all(2 * S <= until <= 2 * S + S // 2 + 50 for until in untils)
    assert len(set(untils)) > 3
    assert tap.on_frame(7, frame(51, direction="fwd"))[0].until < max(untils), "another direction, another order"
    assert tap_of(Delays, sham=True).on_frame(S, frame(0)) == (Delay(S + NS_PER_US),)


def test_copies_follow_and_those_of_a_sham_are_benign() -> None:
    tap, sham = tap_of(Duplicates), tap_of(Duplicates, sham=True)
    assert tap.on_frame(S, frame(3)) == sham.on_frame(S, frame(3)) == ()
    copies, benign = woken(tap, 9 * S), woken(sham, 9 * S)
    assert [at for at, _ in copies] == [at for at, _ in benign] == [S + S // 4, S + S // 2]
    assert {copy for _, copy in copies} == {Inject(POSITION, "rev", *ENDS[::-1], frame(3).id)}
    payloads = {copy.payload for _, copy in benign if isinstance(copy, Inject)}
    assert {(len(payload), decode(payload).get_type()) for payload in payloads} == {
        (len(POSITION), "ENCAPSULATED_DATA")
    }


def test_many_copies_of_one_time_come_by_and_by() -> None:
    tap = tap_of(Duplicates, copies=1)
    for number in range(150):
        tap.on_frame(0, frame(number))
    found = woken(tap, 9 * S)
    assert [at - S // 4 for at, _ in found] == [0] * 64 + [1] * 64 + [2] * 22
    parents = [copy.parent.serial for _, copy in found if isinstance(copy, Inject) and copy.parent]
    assert parents == list(range(150))


def altered(tap: Any, payload: bytes, now: Time = 0) -> Any:
    (verdict,) = tap.on_frame(now, frame(0, payload))
    assert isinstance(verdict, Replace)
    return decode(verdict.payload)


def position(lat: int = 407_780_000, relative_alt: int = 5_000, packer: Packer = PACKER) -> bytes:
    return packer.pack(dialect.MAVLink_global_position_int_message(1, lat, 2, 3, relative_alt, 100, -50, 3, 9000))


def test_a_field_is_altered_within_its_range() -> None:
    assert altered(tap_of(Climbs), position()).relative_alt == 6_500
    assert altered(tap_of(Climbs, by_mm=1e12), position()).relative_alt == 2**31 - 1
    assert altered(tap_of(Climbs), position()).vx == 100
    assert altered(tap_of(Mirrors), position()).vz == -3
    local = PACKER.pack(dialect.MAVLink_local_position_ned_message(1, 0, 0, 0, 0, 0, 2.5))
    assert altered(tap_of(Mirrors), local).vz == -2.5
    assert altered(tap_of(Tells), PACKER.pack(dialect.MAVLink_statustext_message(3, b"crash"))).text == "CRASH"
    sham = position()
    assert tap_of(Climbs, sham=True).on_frame(0, frame(0, sham)) == (Replace(sham),)
    assert not tap_of(Climbs).on_frame(0, frame(0, PACKER.pack(dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3))))
    assert not tap_of(Climbs).on_frame(0, frame(0, b"no frame"))


def test_a_held_field_is_that_before_the_start() -> None:
    tap, other = tap_of(Freezes, start_s=5.0), Packer(7, 1)
    for now, lat in [(S, 100), (2 * S, 200), (5 * S - 1, 300)]:
        assert not tap.on_frame(now, frame(0, position(lat)))
    assert not tap.on_frame(3 * S, frame(0, position(9, packer=other)))
    assert [altered(tap, position(lat), 5 * S).lat for lat in (400, 500)] == [300, 300]
    assert altered(tap, position(11, packer=other), 5 * S).lat == 9, "each sender has its own"
    gps = [PACKER.pack(dialect.MAVLink_gps_raw_int_message(1, 3, lat, 0, 0, 0, 0, 0, 0, 9)) for lat in (1, 2)]
    assert [altered(tap, one, 6 * S).lat for one in gps] == [1, 1], "the first one, where none passed before"
    sham = tap_of(Freezes, start_s=5.0, sham=True)
    sham.on_frame(S, frame(0, position(1)))
    later = position(2)
    assert sham.on_frame(5 * S, frame(0, later)) == (Replace(later),)


def told(kind: Any, *heights: float, sham: bool = False, start: Time = 2 * S) -> list[list[float]]:
    """What the barometers read when an act begins at 2 s and they measure these heights more, a second apart."""
    hook, found = fault(kind.plugin, sensor_context(start, sham)), []
    for number, height in enumerate(heights):
        sensors = readings()
        sensors.baro_up_m += height
        hook.on_sensors(S + number * S, sensors)
        found.append((sensors.baro_up_m - readings().baro_up_m).tolist())
    return found


def test_a_reading_is_altered_or_held_from_the_start_on() -> None:
    assert told(Lifts, 0.0, 0.0, 1.0) == [[0.0, 0.0], pytest.approx([4.0, 4.0]), pytest.approx([5.0, 5.0])]
    assert told(Sticks, 0.0, 1.0, 2.0) == [[0.0, 0.0], pytest.approx([1.0, 1.0]), pytest.approx([1.0, 1.0])]
    for kind in (Lifts, Sticks):
        assert told(kind, 0.0, 1.0, 2.0, sham=True) == [pytest.approx([more, more]) for more in (0.0, 1.0, 2.0)]


def test_whole_readings_are_rounded_and_others_left() -> None:
    true, sensors = readings(), readings()
    true.gnss_satellites[:] = sensors.gnss_satellites[:] = [9, 12]
    fault(Blinds.plugin).on_sensors(2 * S, sensors)
    assert sensors.gnss_satellites.tolist() == [4, 5]
    for one in fields(Sensors):
        if one.name != "gnss_satellites":
            assert getattr(sensors, one.name).tobytes() == getattr(true, one.name).tobytes()


@pytest.mark.parametrize(
    ("act", "words"),
    [
        (lambda: sky.alter_field("relative_altt", "by_m"), "Did you mean 'relative_alt'"),
        (lambda: sky.hold_field("latt"), "Did you mean 'lat"),
        (lambda: sky.alter_reading("baro_up", "by_m"), "Did you mean 'baro_up_m'"),
        (lambda: sky.hold_reading("baro_up"), "Did you mean 'baro_up_m'"),
    ],
)
def test_what_does_not_exist_is_named(act: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        act()


@pytest.mark.parametrize(
    ("base", "name", "act"),
    [
        (sky.OnPath, "act", sky.drop("shar")),
        (sky.OnPath, "act", sky.delay("shar")),
        (sky.OnPath, "act", sky.duplicate(1, "share", "shar")),
        (sky.OnMessages, "alter", sky.alter_field("z", "shar")),
        (sky.OnSensors, "act", sky.alter_reading("baro_up_m", "shar")),
    ],
)
def test_an_act_that_names_no_field_of_its_kind_is_refused(base: Any, name: str, act: Any) -> None:
    body = {
        "__doc__": "Does it.",
        "__annotations__": {"share": sky.Number},
        "share": sky.param("Share.", default=0.5),
        name: act,
    }
    kind = type(base)("Named", (base,), body)
    with registered(), pytest.raises(InputError, match=rf"{name}: shar — expected .*'share'"):
        sky.attack("test.named")(kind)
