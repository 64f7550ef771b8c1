"""Cellular channel of a control link: serving cell, hand-over, radio link failure, rates and hybrid ARQ of LTE.

A terminal uses the highest quality whose efficiency is within log2(1 + SNIR/Γ), Γ = −ln(5·BER)/1.5 with a bit error
rate of 0.00005: G. Piro, N. Baldo, M. Miozzo, "An LTE module for the ns-3 network simulator" (2011), as in ns-3's
`LteAmc`. The efficiencies are those of TS 36.213, table 7.2.3-1.

Block errors: a tenth at the SNIR of a quality, which is what terminals report it for (TS 36.213, 7.2.3), and a decade
of odds per dB around it (assumed; turbo codes fall from 90 to 1 % within 2 dB). The k-th transmission of a block gains
10·log10(k) dB (chase combining).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from skyrange.contracts.frames import Fate
from skyrange.contracts.links import OpenChannel, Uniforms
from skyrange.contracts.medium import Floats
from skyrange.core import elementary, elementary_python, elementwise
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.radio.control_link.interference import Interference
from skyrange.radio.control_link.params import CellularParams

EFFICIENCY: Final = np.array(
    [0.1523, 0.2344, 0.3770, 0.6016, 0.8770, 1.1758, 1.4766, 1.9141, 2.4063, 2.7305, 3.3223, 3.9023, 4.5234, 5.1152,
     5.5547]
)  # fmt: skip
"""Bits per second and Hz of the qualities 1 to 15."""
_GAP: Final = -elementary_python.log(5.0 * 0.00005) / 1.5
MIN_SNIR_DB: Final = np.array(
    [10.0 * elementary_python.log10(_GAP * (elementary_python.power(2.0, bits) - 1.0)) for bits in EFFICIENCY]
)
"""By quality: least SNIR."""
HARQ_NS: Final[Time] = 8 * NS_PER_MS
"""Round trip of a retransmission, eight subframes (TS 36.321, 7.7)."""
MAX_TRANSMISSIONS: Final = 4
Q_OUT_DB: Final = -8.0
Q_IN_DB: Final = -6.0
"""SNIRs at which the control channel loses 10 % and 2 % of blocks (TS 36.133, 7.6; the usual figures, assumed)."""
T310_NS: Final[Time] = 1000 * NS_PER_MS
"""A cell below Qout for this long is lost (TS 36.331, 7.3 and the default configuration of 9.2.2)."""
MEASUREMENT_NS: Final[Time] = 200 * NS_PER_MS
"""Period of measurements (TS 36.133, 8.1.2.2)."""
FILTER: Final = 0.5
"""Weight of a new measurement: filter coefficient 4 (TS 36.331, 5.5.3.2)."""


def quality_of(snir_db: float) -> int:
    """The highest quality for an SNIR, by its place in `EFFICIENCY`; the lowest one below all."""
    return max(int(np.searchsorted(MIN_SNIR_DB, snir_db, side="right")) - 1, 0)


def block_error(quality: int, snir_db: float, transmission: int = 1) -> float:
    """The probability that a block is not decoded after so many transmissions."""
    above_db = snir_db + 10.0 * elementary.log10(transmission) - float(MIN_SNIR_DB[quality])
    odds: float = 9.0 * elementary.exp10(min(max(above_db, -30.0), 30.0))
    return 1.0 / (1.0 + odds)


NO_CELL = -1


class CellularDirection:
    """One direction of a cellular link (`skyrange.contracts.links.OpenChannel`)."""

    __slots__ = ("_busy_until", "_last_arrival", "interference", "link", "quality", "signal_dbm")

    def __init__(self, link: CellularLink, noise_dbm: float) -> None:
        self.link = link
        self.interference = Interference(noise_dbm)
        self.signal_dbm = -math.inf
        self.quality = 0
        """Channel quality in use, by its place in `EFFICIENCY`."""
        self._busy_until: Time = -(2**62)
        self._last_arrival: Time = -(2**62)

    def snir_db(self, at: Time) -> float:
        """Signal-to-noise-and-interference ratio at an instant."""
        return self.signal_dbm - 10.0 * elementary.log10(self.interference.steady_mw(at))

    def carry(self, now: Time, size: int, draws: Uniforms) -> tuple[Fate, Time, Time | None]:
        """As `OpenChannel.carry`."""
        link = self.link
        if link.strengths_dbm is None:  # nothing is known before the first update, in the first instant of a run
            return Fate.DELIVERED, now + link.latency_ns, None
        if link.serving == NO_CELL or now < link.interrupted_until:
            return Fate.LOST, now, None
        rate_bps = float(EFFICIENCY[self.quality]) * link.params.share * link.params.bandwidth_mhz * 1e6
        waiting_ns = max(0, self._busy_until - now)
        if waiting_ns * rate_bps / (8 * NS_PER_S) + size > link.params.queue_bytes:
            return Fate.OVERFLOW, now, None
        end = now + waiting_ns + round(8 * size / rate_bps * NS_PER_S)
        self._busy_until = end
        snir_db, all_failed = self.snir_db(end), 1.0
        for transmission in range(1, MAX_TRANSMISSIONS + 1):
            all_failed *= block_error(self.quality, snir_db, transmission)
            if draws[0] >= all_failed:
                arrival = end + (transmission - 1) * HARQ_NS + link.latency_ns
                self._last_arrival = max(arrival, self._last_arrival)  # delivery in sequence
                return Fate.DELIVERED, self._last_arrival, None
        return Fate.LOST, now, None


class CellularLink:
    """The cellular channel of one control link (`skyrange.contracts.links.VariableChannel`)."""

    __slots__ = (
        "_below_since",
        "_better_since",
        "_measured_ns",
        "_power_mw",
        "_samples",
        "aircraft_noise_dbm",
        "interrupted_until",
        "latency_ns",
        "name",
        "params",
        "row",
        "serving",
        "strengths_dbm",
        "to_aircraft",
        "to_station",
        "vehicle",
    )

    def __init__(
        self, name: str, params: CellularParams, vehicle: str, aircraft_noise_dbm: float, station_noise_dbm: float
    ) -> None:
        self.name = name
        self.params = params
        self.vehicle = vehicle
        self.row = -1
        """Row of the aircraft among all radios."""
        self.latency_ns: Time = round(params.latency_ms * NS_PER_MS)
        self.aircraft_noise_dbm = aircraft_noise_dbm
        """Thermal noise of its receiver; the other cells' interference comes on top."""
        self.to_aircraft = CellularDirection(self, aircraft_noise_dbm)
        self.to_station = CellularDirection(self, station_noise_dbm)
        self.serving = NO_CELL
        """Place of the serving cell in `params.base_stations`."""
        self.interrupted_until: Time = -(2**62)
        self.strengths_dbm: Floats | None = None
        """(cells,) filtered strength of each cell's signal."""
        self._measured_ns: Time = 0
        self._power_mw: Floats = np.zeros(len(params.base_stations))
        self._samples = 0
        self._better_since: dict[int, Time] = {}
        self._below_since: Time | None = None

    def open(self, direction: str) -> OpenChannel:
        """The direction `fwd`, from the station to the aircraft, or `rev`."""
        return self.to_aircraft if direction == "fwd" else self.to_station

    def describe(self) -> Mapping[str, Any]:
        """What the manifest says of it."""
        return {"kind": "cellular", **self.params.model_dump(mode="json")}

    @property
    def cell(self) -> str:
        """Name of the serving cell; empty without one."""
        return "" if self.serving == NO_CELL else self.params.base_stations[self.serving].id

    def measure(self, now: Time, powers_dbm: Floats) -> tuple[str, str] | None:
        """Measure the cells, (cells,) dBm, and hand over by the event A3; returns the cells before and after one.

        A measurement is the mean power since the last one (TS 36.214, 5.1.1, averages over the measurement period).
        The event (TS 36.331, 5.5.4.4) begins when a neighbour less the hysteresis is better than the serving cell plus
        the offset, ends when it is not with the hysteresis added, and counts when it has held for the time to trigger.
        """
        if self.strengths_dbm is None:
            self._measured_ns = now
            self.strengths_dbm = powers_dbm.copy()
            self.serving = int(np.argmax(powers_dbm))
            return "", self.cell
        self._power_mw = self._power_mw + elementwise.exp10(0.1 * powers_dbm)
        self._samples += 1
        if now - self._measured_ns < MEASUREMENT_NS:
            return None
        self._measured_ns = now
        powers_dbm = 10.0 * elementwise.log10(np.maximum(self._power_mw / self._samples, 1e-30))
        self._power_mw, self._samples = np.zeros_like(powers_dbm), 0
        self.strengths_dbm = (1.0 - FILTER) * self.strengths_dbm + FILTER * powers_dbm
        if self.serving == NO_CELL:
            return None
        own_dbm = float(self.strengths_dbm[self.serving]) + self.params.a3_offset_db
        for cell, strength_dbm in enumerate(self.strengths_dbm.tolist()):
            if cell == self.serving or strength_dbm + self.params.hysteresis_db < own_dbm:
                self._better_since.pop(cell, None)
            elif strength_dbm - self.params.hysteresis_db > own_dbm:
                self._better_since.setdefault(cell, now)
        wait_ns = self.params.time_to_trigger_ms * NS_PER_MS
        ready = [cell for cell, since in self._better_since.items() if now - since >= wait_ns]
        if not ready:
            return None
        before = self.cell
        self._attach(now, max(ready, key=lambda cell: float(self._strength(cell))), self.params.interruption_ms)
        return before, self.cell

    def monitor(self, now: Time, snir_db: float) -> str:
        """Watch the serving cell, or look for one: returns `"failure"` or `"cell found"` if that has changed."""
        if self.strengths_dbm is None:
            return ""
        if self.serving == NO_CELL:
            if snir_db < Q_IN_DB:
                return ""
            self._attach(now, int(np.argmax(self.strengths_dbm)), self.params.reestablishment_ms)
            return "cell found"
        if snir_db >= Q_OUT_DB:
            self._below_since = None
        elif self._below_since is None:
            self._below_since = now
        elif now - self._below_since >= T310_NS:
            self.serving, self._below_since = NO_CELL, None
            self._better_since.clear()
            return "failure"
        return ""

    def set_conditions(self, now: Time, down_dbm: float, up_dbm: float) -> None:
        """Take over the powers of the serving cell's signal at the aircraft and of the aircraft's there.

        The quality in use is that of the conditions before: a report is some milliseconds old.
        """
        for direction, dbm in ((self.to_aircraft, down_dbm), (self.to_station, up_dbm)):
            direction.quality = quality_of(direction.snir_db(now))
            direction.signal_dbm = dbm

    def _attach(self, now: Time, cell: int, interruption_ms: float) -> None:
        self.serving = cell
        self.interrupted_until = now + round(interruption_ms * NS_PER_MS)
        self._better_since.clear()

    def _strength(self, cell: int) -> float:
        assert self.strengths_dbm is not None
        return float(self.strengths_dbm[cell])
