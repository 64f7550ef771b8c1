"""RSSI and noise of SiK radios over distance: those of telemetry logs beside those of the model.

    python -m tools.sik_levels FLIGHT.tlog …

It prints the table of docs/explanation/control-links.md, and the range of the model at the sensitivity of each rate.
Distances are from the first position of each log, where the ground radio is assumed to be. A log does not tell the
power, frequency and antennas of its radios; the model has the defaults of `links.sik`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from skyrange.core.geodesy import Origin
from skyrange.flightlog.model import FlightLog
from skyrange.flightlog.reading import read_log
from skyrange.radio.control_link.sik.modem import (
    AIR_SPEEDS_KBPS,
    filter_khz,
    noise_figure_db,
    rssi_of,
    sensitivity_dbm,
)
from skyrange.radio.control_link.sik.params import SikParams
from skyrange.radio.propagation.link_budget import median_power_dbm
from skyrange.radio.propagation.path_loss import noise_dbm, wavelength_m

DISTANCES_M = (5, 10, 20, 50, 100, 200)
STATION_M = 2.0
AIRCRAFT_M = 30.0
"""Heights of the two antennas in the model."""
_DIPOLE, _ISOTROPIC = 1.0, 0.0


def model_dbm(distance_m: float, params: SikParams, aircraft_m: float = AIRCRAFT_M) -> float:
    """Median power at the aircraft's radio over open ground, at a distance along the ground."""
    height = aircraft_m - STATION_M
    slant = float(np.hypot(distance_m, height))
    return float(
        median_power_dbm(
            float(params.power_dbm), slant, STATION_M, aircraft_m, wavelength_m(params.centre_mhz), _DIPOLE, 0.0,
            _ISOTROPIC, 0.0,
        )
    )  # fmt: skip


def find_range_m(params: SikParams) -> float:
    """Where the median power is the sensitivity: the range without fading, walls and other noise."""
    near, far = 10.0, 1e6
    for _ in range(60):
        middle = (near * far) ** 0.5
        if model_dbm(middle, params) > sensitivity_dbm(params.air_speed_kbps):
            near = middle
        else:
            far = middle
    return near


def model_noise(params: SikParams) -> int:
    """The RSSI of the model's noise, without jammers."""
    width_mhz = filter_khz(params.air_speed_kbps, params.min_khz) / 1e3
    return rssi_of(float(noise_dbm(noise_figure_db(params.air_speed_kbps), width_mhz)))


def read_levels(log: FlightLog) -> np.ndarray:
    """(reports, 5): distance in metres, rssi, remote rssi, noise, remote noise."""
    position, radio = log.tables["position"], log.tables["radio"]
    start = position[0]
    origin = Origin(float(start["lat_deg"]), float(start["lon_deg"]))
    east, north = origin.to_enu(position["lat_deg"], position["lon_deg"])
    up = position["alt_msl_m"] - start["alt_msl_m"]
    away = np.sqrt(east * east + north * north + up * up)
    distance = np.interp(radio["time_s"], position["time_s"], away)
    return np.column_stack([distance, *(radio[name] for name in ("rssi", "remote_rssi", "noise", "remote_noise"))])


def print_levels(name: str, levels: np.ndarray, params: SikParams) -> None:
    """One line for each range of distances."""
    edges = (0, *DISTANCES_M)
    for low, high in pairwise(edges):
        rows = levels[(levels[:, 0] >= low) & (levels[:, 0] < high)]
        if len(rows) < 10:
            continue
        cells = []
        for column in range(1, 5):
            heard = rows[:, column][rows[:, column] > 0]
            fifth, median, most = np.percentile(heard, [5, 50, 95]) if len(heard) else (np.nan,) * 3
            cells.append(f"{median:.0f} ({fifth:.0f} to {most:.0f})")
        expected = rssi_of(model_dbm(max(float(np.median(rows[:, 0])), 1.0), params, STATION_M + 1.0))
        print(f"| {name} | {low} to {high} | {len(rows)} | {' | '.join(cells)} | {expected} | {model_noise(params)} |")


def list_ranges() -> list[str]:
    """One line for each rate: sensitivity, its RSSI, and range."""
    lines = []
    for rate in AIR_SPEEDS_KBPS[1:]:
        at, reach = sensitivity_dbm(rate), find_range_m(SikParams(air_speed_kbps=rate))
        lines.append(f"| {rate} | {at:.1f} | {rssi_of(at)} | {reach:.0f} |")
    return lines


def main(paths: Sequence[str]) -> None:
    """Print the tables."""
    params = SikParams()
    print("| log | distance, m | reports | rssi | remrssi | noise | remnoise | rssi, model | noise, model |")
    print("|---|---|---|---|---|---|---|---|---|")
    for path in paths:
        print_levels(Path(path).stem, read_levels(read_log(Path(path))), params)
    print()
    print("| air rate, kbit/s | sensitivity, dBm | RSSI there | range, m |")
    print("|---|---|---|---|")
    print("\n".join(list_ranges()))


if __name__ == "__main__":
    main(sys.argv[1:])
