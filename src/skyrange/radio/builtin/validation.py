"""Validation of radio specifications: every problem at once, before a medium is built."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from skyrange.contracts.medium import RadioSpec, ScanSchedule, Waveform
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.radio.builtin.environment import RadioEnvironment
from skyrange.radio.builtin.state import ANTENNAS
from skyrange.radio.phy.channels import ADVERTISING_CHANNELS, WIFI_CHANNELS

if TYPE_CHECKING:
    from skyrange.city.city import City


def check_radios(radios: Sequence[RadioSpec], city: City | None, surroundings: RadioEnvironment) -> None:
    """Raise one `InputError` with everything that is wrong."""
    problems = []
    seen: set[str] = set()
    for radio in radios:
        if radio.name in seen:
            problems.append(Problem(radio.name, "two radios", "names that are used once"))
        seen.add(radio.name)
        problems += _faults_of(radio, city)
    if not 0.0 < surroundings.horizon_m < math.inf:
        problems.append(Problem("horizon_m", repr(surroundings.horizon_m), "a positive number of metres"))
    if not 0.0 <= surroundings.city_busy < 1.0:
        problems.append(Problem("city_busy", repr(surroundings.city_busy), "a share of time, 0 to less than 1"))
    if not -200.0 < surroundings.city_dbm < 60.0:
        problems.append(Problem("city_dbm", repr(surroundings.city_dbm), "a power in dBm, -200 to 60"))
    sense = surroundings.carrier_sense_dbm
    if sense is not None and not -200.0 < sense < 60.0:
        problems.append(Problem("carrier_sense_dbm", repr(sense), "a power in dBm, -200 to 60, or None"))
    if problems:
        raise InputError("radio", problems)


def _faults_of(radio: RadioSpec, city: City | None) -> Iterator[Problem]:
    place = radio.place_enu_m
    if place is not None:
        if not all(map(math.isfinite, place)):
            yield Problem(f"{radio.name}.place", repr(place), "three finite numbers")
        elif place[2] < 0.0:
            yield Problem(f"{radio.name}.place", repr(place), "a place on the ground (0) or above")
        elif city is not None and (building := city.inside(*place)) is not None:
            yield Problem(f"{radio.name}.place", repr(place), f"a place outside buildings; {building.id} stands there")
    if radio.antenna not in ANTENNAS:
        yield Problem(f"{radio.name}.antenna", repr(radio.antenna), "a known antenna", nearest(radio.antenna, ANTENNAS))
    for name, least, most in (
        ("wifi_dbm", -60.0, 60.0),
        ("ble_dbm", -60.0, 60.0),
        ("gain_dbi", -60.0, 40.0),
        ("noise_figure_db", 0.0, 60.0),
    ):
        value = getattr(radio, name)
        if not least <= value <= most:
            yield Problem(f"{radio.name}.{name}", repr(value), f"a number from {least:g} to {most:g}")
    bands = [_band(chain) for chain in radio.listening]
    if None in bands:
        yield Problem(
            f"{radio.name}.listening",
            repr(radio.listening),
            "turns of one band, on Wi-Fi channels 1 to 13 or advertising channels 37 to 39",
        )
    elif len(set(bands)) < len(bands):
        yield Problem(f"{radio.name}.listening", f"{len(bands)} chains", "at most one in each band")
    for chain in radio.listening:
        alone = len(chain.turns) == 1 and chain.rest_ns == 0 and chain.window_ns == chain.dwell_ns == 0
        if not alone and (not 0 < chain.window_ns <= chain.dwell_ns or chain.rest_ns < 0):
            times = f"{chain.window_ns} of {chain.dwell_ns} ns, rest {chain.rest_ns} ns"
            yield Problem(f"{radio.name}.listening", times, "0 < window_ns <= dwell_ns, and a rest of 0 or more")


def _band(chain: ScanSchedule) -> bool | None:
    """Whether all turns of a chain are Wi-Fi (True) or all Bluetooth (False); None for neither."""
    kinds = {waveform < Waveform.BLE_1M for turn in chain.turns for waveform in turn.waveforms}
    if len(kinds) != 1 or not all(turn.waveforms for turn in chain.turns):
        return None
    wifi = kinds.pop()
    channels = WIFI_CHANNELS if wifi else ADVERTISING_CHANNELS
    return wifi if all(turn.channel in channels for turn in chain.turns) else None
