"""Does the builtin medium keep its contract? Cuts, company, chance, carrier sense, receivers, noise, refusals."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import shapely

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.contracts.medium import (
    ANY_CHANNEL,
    EmitterTable,
    OnAir,
    RadioSpec,
    RadioTable,
    ReceptionOutcome,
    ScanSchedule,
    ScanStep,
    TransmissionFate,
    TxBatch,
    Waveform,
)
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_MS, NS_PER_S, NS_PER_US
from skyrange.radio.builtin.listening import COMPANION, HOPPER, PHONE, PROFILES, wifi_chain
from skyrange.radio.builtin.medium import BuiltinMedium, fixed_positions
from skyrange.radio.builtin.params import RadioEnvironment

STILL = RadioEnvironment(chance=False)
OFDM, BT4, BT5 = Waveform.OFDM_6M, Waveform.BLE_1M, Waveform.BLE_CODED


def standing(name: str, east: float, north: float = 0.0, up: float = 30.0, **more: Any) -> RadioSpec:
    return RadioSpec(name, (east, north, up), **{"listening": COMPANION, **more})


def batch(*rows: tuple[int, int, int, int], channel: int = ANY_CHANNEL, size: int = 200) -> TxBatch:
    """Rows of (radio, at, waveform, key)."""
    table = np.array(rows, dtype=np.int64).reshape(-1, 4)
    sizes = np.where(table[:, 2] == BT4, 37, size)
    return TxBatch(
        table[:, 0],
        table[:, 1],
        table[:, 2],
        np.full(len(rows), channel),
        np.full(len(rows), np.nan),
        sizes,
        table[:, 3],
    )


def noise(*rows: tuple[int, float, float, float, int, int]) -> EmitterTable:
    columns = [np.array(column) for column in zip(*rows, strict=True)] or [np.zeros(0)] * 6
    kinds = (np.int64, np.float64, np.float64, np.float64, np.int64, np.int64)
    cast_columns: list[Any] = [column.astype(kind) for column, kind in zip(columns, kinds, strict=True)]
    return EmitterTable(*cast_columns)


def heard(medium: BuiltinMedium, answers: Sequence[OnAir]) -> list[tuple[Any, ...]]:
    rows: list[tuple[Any, ...]] = []
    for answer in answers:
        table = zip(*(column.tolist() for column in answer.heard), strict=True)
        rows += [(row[0], medium.radios[row[1]].name, *row[2:]) for row in table]
    return rows


def sent(medium: BuiltinMedium, answers: Sequence[OnAir]) -> list[tuple[Any, ...]]:
    rows: list[tuple[Any, ...]] = []
    for answer in answers:
        table = zip(*(column.tolist() for column in answer.sent), strict=True)
        rows += [(row[0], medium.radios[row[1]].name, *row[2:]) for row in table]
    return rows


def storm(medium: BuiltinMedium, cut_ns: int, until_ns: int = 2 * NS_PER_S, names: Sequence[str] = ()) -> list[OnAir]:
    """All of `names` broadcast on all transports while they move; positions change every 10 ms, whatever the cut."""
    rows = [row for row, radio in enumerate(medium.radios) if radio.name in names]
    rng = np.random.default_rng(5)
    starts = {name: rng.uniform([-200, -200, 20], [200, 200, 60]) for name in sorted(names)}
    table = fixed_positions(medium.radios)
    events = []
    key = 0
    for second in range(until_ns // NS_PER_S):
        for k, row in enumerate(rows):
            at = second * NS_PER_S + (k % 7) * 120 * NS_PER_MS + 137 + 40 * k
            for waveform in (Waveform.DSSS_1M, OFDM, BT4, BT5):
                events.append((row, at, int(waveform), key))
                key += 1
    answers = []
    done = 0
    for now in range(cut_ns, until_ns + 1, cut_ns):
        tick = (now - 1) // (10 * NS_PER_MS) * 10 * NS_PER_MS
        pos, vel = table.pos_enu_m.copy(), table.vel_enu_mps.copy()
        for row in rows:
            pos[row] = starts[medium.radios[row].name] + np.array([12.0, 5.0, 0.0]) * (tick / NS_PER_S)
            vel[row] = (12.0, 5.0, 0.0)
        ready = [event for event in events if done < event[1] <= now]
        if ready:
            medium.offer(now, batch(*ready))
        answers.append(medium.advance(now, RadioTable(tick, pos, vel)))
        done = now
    return answers


def city() -> City:
    boxes = [(x, y, x + 30.0, y + 25.0) for x in range(-200, 200, 60) for y in range(-200, 200, 55)]
    return City([Building(str(k), 25.0 + 7.0 * (k % 6), shapely.box(*box)) for k, box in enumerate(boxes)], "test")


NAMES = [f"blue/b{k}" for k in range(12)]


def town(extra: Sequence[RadioSpec] = (), **more: Any) -> BuiltinMedium:
    moving = [RadioSpec(name, listening=COMPANION) for name in NAMES]
    grounds = [
        standing("mast", 17.0, 27.0, 2.0, listening=HOPPER),
        standing("phone", -23.0, 27.0, 1.5, listening=PHONE),
    ]
    return BuiltinMedium([*moving, *grounds, *extra], Chance(3), city(), RadioEnvironment(city_busy=0.2), **more)


def test_the_cut_of_time_changes_nothing() -> None:
    """1 ms, 10 ms and 50 ms: every burst and every reception, its times and its numbers, to the bit."""
    fine, coarse = town(every_pair=True), town(every_pair=True)
    a, b = storm(fine, NS_PER_MS, names=NAMES), storm(coarse, 10 * NS_PER_MS, names=NAMES)
    assert len(heard(fine, a)) > 200
    assert heard(fine, a) == heard(coarse, b)
    assert sorted(sent(fine, a)) == sorted(sent(coarse, b))
    assert (fine.losses == coarse.losses).all()
    assert set(ReceptionOutcome) - {int(row[-1]) for row in heard(fine, a)} <= {
        ReceptionOutcome.ELSEWHERE,
        ReceptionOutcome.SENDING,
    }


def test_who_is_out_of_reach_changes_nothing() -> None:
    """Radios far off, before and after the others by name, busy or not."""
    names = [*NAMES, "aaa", "zzz"]
    far = [standing("aaa", 90_000.0), standing("zzz", -90_000.0, 90_000.0)]
    alone, company = town(), town(far)
    a = storm(alone, 10 * NS_PER_MS, names=NAMES)
    b = storm(company, 10 * NS_PER_MS, names=NAMES)
    keys = {row[0] for row in heard(alone, a)}
    assert len(keys) > 20
    assert [row[1:] for row in heard(alone, a)] == [row[1:] for row in heard(company, b)]
    spoken = town(far)
    rows = [row for row, radio in enumerate(spoken.radios) if radio.name in ("aaa", "zzz")]
    spoken.offer(0, batch(*((row, 1 + 700 * k, int(OFDM), 10**6 + k) for k, row in enumerate(rows * 40))))
    assert [row[1:] for row in heard(alone, a)] == [
        row[1:] for row in heard(spoken, storm(spoken, 10 * NS_PER_MS, names=NAMES))
    ]
    assert names


def test_a_copy_goes_on_alike() -> None:
    trunk = town()
    moment = 700 * NS_PER_MS
    table = fixed_positions(trunk.radios)
    table.pos_enu_m[: len(NAMES)] = [(30.0 * k, 10.0, 50.0) for k in range(len(NAMES))]
    trunk.offer(0, batch(*((k, moment - 5 * NS_PER_MS, int(BT5), k) for k in range(len(NAMES)))))
    trunk.advance(moment, table)
    branch = copy.deepcopy(trunk)
    one = [trunk.advance(moment + k * NS_PER_MS, table) for k in range(1, 80)]
    two = [branch.advance(moment + k * NS_PER_MS, table) for k in range(1, 80)]
    assert heard(trunk, one) == heard(branch, two) != []
    assert trunk.quiet
    assert branch.quiet


def test_two_in_sight_hear_each_other_and_strength_is_friis() -> None:
    """15 dBm over 100 m at 2437 MHz: 15 − 80.18 dBm; 0.02 dB."""
    medium = BuiltinMedium([standing("a", 0.0), standing("b", 100.0)], Chance(1), surroundings=STILL)
    medium.offer(0, batch((0, 1, int(OFDM), 7)))
    answer = medium.advance(10 * NS_PER_MS, fixed_positions(medium.radios))
    assert heard(medium, [answer])[0][:2] == (7, "b")
    assert answer.heard.rssi_dbm[0] == pytest.approx(15.0 - 80.18, abs=0.02)
    assert answer.heard.ended_ns[0] == answer.sent.ended_ns[0] == 1 + 28_000 + (26 + 4 * 68) * NS_PER_US


def test_a_wall_between_silences() -> None:
    wall = City([Building("w", 200.0, shapely.box(40.0, -3_000.0, 60.0, 3_000.0))], "test")
    radios = [standing("a", 0.0), standing("b", 100.0), standing("c", 30.0)]
    medium = BuiltinMedium(radios, Chance(1), wall, STILL)
    medium.offer(0, batch((0, 1, int(BT4), 7), (0, 2, int(OFDM), 8)))
    names = {row[1] for row in heard(medium, [medium.advance(50 * NS_PER_MS, fixed_positions(medium.radios))])}
    assert names == {"c"}
    assert medium.losses[1, ReceptionOutcome.WEAK] > 0


def test_a_radio_at_no_place_is_not_there() -> None:
    medium = BuiltinMedium([standing("a", 0.0), RadioSpec("b", listening=COMPANION)], Chance(1))
    medium.offer(0, batch((0, 1, int(OFDM), 7), (1, 2, int(OFDM), 8)))
    answer = medium.advance(10 * NS_PER_MS, fixed_positions(medium.radios))
    assert len(answer.heard.key) == 0
    assert sorted(zip(answer.sent.key.tolist(), answer.sent.fate.tolist(), strict=True)) == [
        (7, 0),
        (8, TransmissionFate.NO_ACCESS),
    ]


def test_senders_that_hear_each_other_take_turns() -> None:
    """Asked 20 µs apart, the second waits for the first; asked within what neither can sense, they may collide."""
    medium = BuiltinMedium([standing(n, 10.0 * k) for k, n in enumerate("abc")], Chance(1), surroundings=STILL)
    medium.offer(0, batch((0, 1_000, int(OFDM), 1), (1, 21_000, int(OFDM), 2), (1, 22_000, int(OFDM), 3)))
    answer = medium.advance(20 * NS_PER_MS, fixed_positions(medium.radios))
    times = sorted(zip(answer.sent.started_ns.tolist(), answer.sent.ended_ns.tolist(), strict=True))
    assert len(times) == 3
    for (_, end), (start, _) in pairwise(times):
        assert start >= end + 28_000
    assert sum(row[1] == "c" for row in heard(medium, [answer])) == 3


def test_hidden_senders_collide() -> None:
    """Two on both sides of a tower do not sense each other; who stands between them in the open hears neither."""
    tower = City([Building("w", 300.0, shapely.box(-20.0, 1.0, 20.0, 2_000.0))], "test")
    radios = [standing("a", -300.0, 60.0), standing("b", 300.0, 60.0), standing("mid", 0.0, -2.0)]
    medium = BuiltinMedium(radios, Chance(1), tower, STILL)
    medium.offer(0, batch((0, 1_000, int(OFDM), 1), (1, 90_000, int(OFDM), 2)))
    answer = medium.advance(20 * NS_PER_MS, fixed_positions(medium.radios))
    assert answer.sent.started_ns[1] < answer.sent.ended_ns[0]
    assert "mid" not in {row[1] for row in heard(medium, [answer])}
    assert medium.losses[2, ReceptionOutcome.COLLIDED] + medium.losses[2, ReceptionOutcome.BUSY] == 2


def test_who_sends_does_not_hear() -> None:
    """Two that do not sense each other, by their `carrier_sense_dbm`, but would hear one another: -86 dBm."""
    radios = [standing("a", 0.0, wifi_dbm=-6.0), standing("b", 100.0, wifi_dbm=-6.0)]
    deaf = RadioEnvironment(chance=False, carrier_sense_dbm=-82.0)
    medium = BuiltinMedium(radios, Chance(1), surroundings=deaf)
    medium.offer(0, batch((0, 1_000, int(OFDM), 1), (1, 90_000, int(OFDM), 2)))
    medium.advance(20 * NS_PER_MS, fixed_positions(medium.radios))
    assert medium.losses[:, ReceptionOutcome.SENDING].tolist() == [1, 1]


def test_other_channels_do_not_disturb() -> None:
    radios = [standing("a", 0.0, listening=()), standing("b", 5.0, listening=()), standing("c", 10.0)]
    medium = BuiltinMedium(radios, Chance(1), surroundings=STILL)
    medium.offer(0, batch((0, 1_000, int(OFDM), 1)))
    medium.offer(0, batch((1, 1_000, int(OFDM), 2), channel=11))
    answer = medium.advance(20 * NS_PER_MS, fixed_positions(medium.radios))
    assert [row[:2] for row in heard(medium, [answer])] == [(1, "c")]
    assert medium.losses[2].tolist() == [1, 0, 0, 0, 0, 1]


def test_bluetooth_is_heard_where_one_listens() -> None:
    """A scanner stays on a channel for its window: one PDU of three at most, and none in its gaps."""
    scan = ScanSchedule((ScanStep(38, (BT4,)),), 200 * NS_PER_MS, 100 * NS_PER_MS)
    medium = BuiltinMedium(
        [standing("a", 0.0, listening=()), standing("b", 20.0, listening=(scan,))], Chance(1), surroundings=STILL
    )
    for k in range(400):
        medium.offer(0, batch((0, 1 + k * 37 * NS_PER_MS, int(BT4), k)))
    answer = medium.advance(20 * NS_PER_S, fixed_positions(medium.radios))
    assert set(answer.heard.channel.tolist()) == {38}
    assert len(answer.heard.key) == pytest.approx(200, abs=40)  # 4 sigma of a fair coin
    assert len(np.unique(answer.heard.key)) == len(answer.heard.key)


def test_long_range_is_heard_through_its_pointers() -> None:
    """Only who decoded a pointer follows it, to a data channel that changes; S=8 reaches where 1M does not."""
    radios = [standing("a", 0.0, ble_dbm=-18.0), standing("b", 150.0), standing("old", 1.0, listening=(wifi_chain(6),))]
    medium = BuiltinMedium(radios, Chance(1), surroundings=STILL)
    for k in range(60):
        medium.offer(
            0, batch((0, 1 + k * 200 * NS_PER_MS, int(BT5), 2 * k), (0, 2 + k * 200 * NS_PER_MS, int(BT4), 2 * k + 1))
        )
    rows = heard(medium, [medium.advance(20 * NS_PER_S, fixed_positions(medium.radios))])
    assert {row[1] for row in rows} == {"b"}
    assert all(row[0] % 2 == 0 for row in rows)
    channels = {row[2] for row in rows}
    assert channels <= set(range(37))
    assert len(channels) > 5
    assert 20 <= len(rows) <= 40  # Coded half of the time


def test_a_jammer_covers_a_band_and_keeps_senders_waiting() -> None:
    radios = [standing("a", 0.0), standing("b", 100.0), standing("jam", 110.0, listening=())]
    table = fixed_positions(sorted(radios, key=lambda radio: radio.name))

    def run(power_dbm: float, centre: float) -> tuple[int, int]:
        medium = BuiltinMedium(radios, Chance(1), surroundings=STILL)
        medium.emit(0, noise((2, centre, 20.0, power_dbm, 0, NS_PER_S)))
        medium.offer(0, batch(*((0, 1 + k * 50 * NS_PER_MS, int(OFDM), k) for k in range(10))))
        answer = medium.advance(NS_PER_S, table)
        return len(answer.heard.key), int((answer.sent.fate == TransmissionFate.NO_ACCESS).sum())

    assert run(-60.0, 2437.0) == (10, 0)
    assert run(0.0, 2437.0) == (0, 0)
    assert run(0.0, 2472.0) == (10, 0)
    assert run(40.0, 2437.0) == (0, 10)


def test_senders_wait_for_noise_of_62_dbm_whatever_adds_up_to_it() -> None:
    """IEEE 802.11-2020 17.3.10.6. Two equal jammers are 3.01 dB more than one."""
    radios = [standing("a", 0.0), standing("j1", 110.0, listening=()), standing("j2", -110.0, listening=())]
    table = fixed_positions(radios)
    medium = BuiltinMedium(radios, Chance(1), surroundings=STILL)
    medium.offer(0, batch((1, 1, int(OFDM), 1)))
    (heard_dbm,) = medium.advance(10 * NS_PER_MS, table).heard.rssi_dbm
    loss_db = 15.0 - heard_dbm

    def fate(*received_dbm: float) -> TransmissionFate:
        medium = BuiltinMedium(radios, Chance(1), surroundings=STILL)
        powers = enumerate(received_dbm, 1)
        medium.emit(0, noise(*((k, 2437.0, 20.0, dbm + loss_db, 0, NS_PER_S) for k, dbm in powers)))
        medium.offer(0, batch((0, NS_PER_MS, int(OFDM), 0)))
        return TransmissionFate(medium.advance(NS_PER_S, table).sent.fate[0])

    assert fate(-62.1) == fate(-65.1, -65.1) == TransmissionFate.SENT
    assert fate(-61.9) == fate(-64.9, -64.9) == TransmissionFate.NO_ACCESS


def test_noise_ends_when_it_is_told_to() -> None:
    radios = [standing("a", 0.0), standing("b", 100.0), standing("jam", 110.0, listening=())]
    medium = BuiltinMedium(radios, Chance(1), surroundings=STILL)
    table = fixed_positions(medium.radios)
    medium.emit(0, noise((2, 2437.0, 20.0, 0.0, 0, 10 * NS_PER_S)))
    medium.offer(0, batch((0, 1, int(OFDM), 1), (0, 100 * NS_PER_MS, int(OFDM), 2)))
    medium.advance(50 * NS_PER_MS, table)
    medium.emit(60 * NS_PER_MS, noise())
    assert medium.advance(NS_PER_S, table).heard.key.tolist() == [2]


def test_what_does_not_exist_is_refused() -> None:
    medium = BuiltinMedium([standing("a", 0.0), standing("b", 10.0)], Chance(1))
    good = batch(*((0, 1 + k, int(OFDM), k) for k in range(7)))
    sizes = np.array([0, -1, 10**9, 200, 200, 200, 200])
    channels = np.array([6, 6, 6, 0, 14, 6, 6])
    powers = np.array([0.0, 0.0, 0.0, 0.0, 0.0, math.inf, 15.0])
    medium.offer(0, good._replace(size_bytes=sizes, channel=channels, power_dbm=powers))
    medium.offer(0, batch((0, 50, 99, 8)))
    answer = medium.advance(50 * NS_PER_MS, fixed_positions(medium.radios))
    fates = dict(zip(answer.sent.key.tolist(), answer.sent.fate.tolist(), strict=True))
    assert fates == {0: 2, 1: 2, 2: 2, 3: 2, 4: 2, 5: 2, 6: 0, 8: 2}
    for broken in (
        batch((2, 90 * NS_PER_MS, int(OFDM), 1)),
        batch((-1, 90 * NS_PER_MS, int(OFDM), 1)),
        batch((0, 1, int(OFDM), 1)),
    ):
        with pytest.raises(ValueError, match=r"offered|row"):
            medium.offer(60 * NS_PER_MS, broken)
    with pytest.raises(ValueError, match="advance"):
        medium.advance(0, fixed_positions(medium.radios))
    with pytest.raises(ValueError, match="shape"):
        medium.advance(60 * NS_PER_MS, fixed_positions(medium.radios[:1]))
    for broken_noise in (
        noise((0, math.nan, 20.0, 0.0, 0, 1)),
        noise((0, 2437.0, 0.0, 0.0, 0, 1)),
        noise((9, 2437.0, 1.0, 0.0, 0, 1)),
    ):
        with pytest.raises(ValueError, match="noise source"):
            medium.emit(0, broken_noise)


def test_all_that_is_wrong_with_radios_is_said_at_once() -> None:
    wall = City([Building("w", 50.0, shapely.box(0.0, 0.0, 10.0, 10.0))], "test")
    radios = [
        standing("nan", math.nan),
        standing("in", 5.0, 5.0),
        standing("below", 20.0, up=-1.0),
        standing("twice", 20.0),
        standing("twice", 21.0),
        standing("odd", 20.0, antenna="dipol", wifi_dbm=math.nan),
        standing("far", 20.0, listening=(wifi_chain(14),)),
        standing("mixed", 20.0, listening=(ScanSchedule((ScanStep(6, (OFDM, BT4)),)),)),
        standing("both", 20.0, listening=(wifi_chain(1), wifi_chain(6))),
        standing("never", 20.0, listening=(ScanSchedule((ScanStep(6, (OFDM,)),), 10, 20),)),
    ]
    wrong = RadioEnvironment(horizon_m=math.nan, city_busy=1.0, city_dbm=math.nan, carrier_sense_dbm=math.nan)
    with pytest.raises(InputError) as caught:
        BuiltinMedium(radios, Chance(1), wall, wrong)
    text = str(caught.value)
    for word in ("nan.place", "in.place", "below.place", "twice", "dipole", "wifi_dbm", "far.listening", "mixed.list",
                 "both.listening", "never.listening", "horizon_m", "city_busy",
                 "city_dbm", "carrier_sense_dbm"):  # fmt: skip
        assert word in text
    assert len(caught.value.problems) == 14


@pytest.mark.parametrize("profile", list(PROFILES))
def test_profiles_are_radios(profile: str) -> None:
    BuiltinMedium([standing("a", 0.0, listening=PROFILES[profile])], Chance(1))
