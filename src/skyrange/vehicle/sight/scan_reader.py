"""Reader of the scans that arrive at companions: what is no scan of a sensor of the aircraft is counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from skyrange.codec.range_scans import RangeScan, unpack_scan
from skyrange.contracts.mailboxes import Outbox
from skyrange.core.errors import DecodeError
from skyrange.core.ids import FrameId
from skyrange.core.whole_numbers import worth_noting
from skyrange.optics.mounted_sensors import MountedSensor, check_scan


class ScanReader:
    """Reads the scans of many aircraft. Deep copies continue alike."""

    def __init__(self, sensors: Mapping[str, Sequence[MountedSensor]]) -> None:
        """`sensors` are those of each aircraft."""
        self._sensors = {(vehicle, one.number): one for vehicle, own in sensors.items() for one in own}
        self._bad: Counter[str] = Counter()

    def read(self, vehicle: str, payload: bytes) -> RangeScan | None:
        """The scan of an aircraft in a payload; None for any other."""
        try:
            return self._decode(vehicle, payload)
        except DecodeError:
            return None

    def read_or_note(self, vehicle: str, payload: bytes, cause: FrameId, out: Outbox) -> RangeScan | None:
        """The same, with a note `event.bad_scan` where it is due for any other."""
        try:
            return self._decode(vehicle, payload)
        except DecodeError as error:
            self._bad[vehicle] += 1
            if worth_noting(self._bad[vehicle]):
                out.note("event.bad_scan", vehicle, {"why": str(error)[:200], "count": self._bad[vehicle]}, (cause,))
            return None

    def _decode(self, vehicle: str, payload: bytes) -> RangeScan:
        scan = unpack_scan(payload)
        sensor = self._sensors.get((vehicle, scan.sensor))
        if sensor is None:
            raise DecodeError(f"sensor {scan.sensor}, which the aircraft does not have")
        check_scan(scan, sensor)
        return scan
