"""Times in the air of each vehicle of a log, by the heartbeats and positions that its telemetry has."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyrange.contracts.monitors import ObservedFrames
from skyrange.core.ids import Port
from skyrange.core.time import Time
from skyrange.detect.episodes import subject_of_link
from skyrange.detect.messages import read_messages
from skyrange.detect.series import AUTOPILOT
from skyrange.flightlog.flights import AIRBORNE_M
from skyrange.record.read.station_frames import payload_column

Spans = tuple[tuple[Time, Time], ...]
"""Begin and end of each flight, in ns, in order."""
_ARMED: Final = dialect.MAV_MODE_FLAG_SAFETY_ARMED
_MM: Final = 1e-3


class _Flight:
    """The flight that is under way."""

    def __init__(self) -> None:
        self.armed = False
        self.ground_m: float | None = None
        """The altitude at arming."""
        self.begin: Time | None = None
        self.last: Time = 0
        self.spans: list[tuple[Time, Time]] = []

    def set_armed(self, *, armed: bool) -> None:
        if armed != self.armed:
            self.finish()
        self.armed = armed

    def take_height(self, at: Time, alt_m: float) -> None:
        if not self.armed:
            return
        if self.ground_m is None:
            self.ground_m = alt_m
        if alt_m - self.ground_m > AIRBORNE_M:
            self.begin, self.last = at if self.begin is None else self.begin, at

    def finish(self) -> None:
        if self.begin is not None:
            self.spans.append((self.begin, self.last))
        self.begin = self.ground_m = None


class AirborneTimes:
    """When each vehicle flew: from the first to the last position `AIRBORNE_M` above that of arming, as in
    `flightlog.flights`.

    A position is that of GLOBAL_POSITION_INT, at the time of its frame; a heartbeat of the autopilot says whether the
    vehicle is armed.
    """

    def __init__(self, ends: Sequence[Port]) -> None:
        """`ends` are numbered by the column `place` of rows."""
        self._ends = ends
        self._flights = [_Flight() for _ in ends]
        self._useful = np.array([port.link.startswith("gcs:") for port in ends], dtype=np.bool_)

    def add(self, table: pa.Table) -> None:
        """Take in rows."""
        frames = _frames(self._ends, table, self._useful)
        beats, positions = (read_messages(frames, name) for name in ("HEARTBEAT", "GLOBAL_POSITION_INT"))
        events = [
            (row, 0, float(mode & _ARMED))
            for row, component, mode in zip(
                beats.rows.tolist(), beats.components.tolist(), beats.values["base_mode"].tolist(), strict=True
            )
            if component == AUTOPILOT
        ]
        events += [
            (row, 1, alt * _MM)
            for row, alt in zip(positions.rows.tolist(), positions.values["alt"].tolist(), strict=True)
        ]
        for row, is_height, value in sorted(events):
            flight = self._flights[int(frames.places[row])]
            if is_height:
                flight.take_height(int(frames.at_ns[row]), value)
            else:
                flight.set_armed(armed=value > 0.0)

    def spans(self, subject: str) -> Spans:
        """When a vehicle was in the air, up to the last row: the longer ones, if it was seen at several ends."""
        found: list[Spans] = [()]
        for port, flight in zip(self._ends, self._flights, strict=True):
            if subject_of_link(port.link) == subject:
                flight.finish()
                found.append(tuple(flight.spans))
        return max(found, key=airborne_ns)


def airborne_ns(spans: Spans) -> Time:
    """The time in the air."""
    return sum(end - begin for begin, end in spans)


def _frames(ends: Sequence[Port], table: pa.Table, useful: NDArray[np.bool_]) -> ObservedFrames:
    """What telemetry arrived."""
    table = table.combine_chunks()
    places = table.column("place").to_numpy()
    # at the end of an aircraft, its own telemetry is what it sends
    station = np.array([port.endpoint.endswith(".gcs") for port in ends], dtype=np.bool_)
    received = table.column("received").to_numpy() > 0
    chosen = np.flatnonzero(useful[places] & (received == station[places]))
    none = np.zeros(len(chosen), dtype=np.int64)
    return ObservedFrames(
        ends,
        places[chosen],
        received[chosen],
        table.column("at_ns").to_numpy()[chosen],
        payloads=payload_column(table.column("payload")).take(chosen),
        names=[""],
        src=none,
        dst=none,
    )
