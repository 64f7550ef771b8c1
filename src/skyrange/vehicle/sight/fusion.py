"""Fusion of radio and sight in companions: which tracks avoidance believes."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from skyrange.codec.f3411 import printable_id
from skyrange.codec.range_scans import RangeScan
from skyrange.contracts.alerts import Scalar
from skyrange.core.arrays import Floats
from skyrange.core.ids import FrameId
from skyrange.core.time import Time
from skyrange.remoteid.tracks import TrackSnapshot, TrackTable
from skyrange.vehicle.sight.detections import SightTracks
from skyrange.vehicle.sight.evidence import GATE_SIGMAS, Verdict
from skyrange.vehicle.sight.witness import Change, Witness, list_keys

if TYPE_CHECKING:
    from skyrange.contracts.mailboxes import Outbox
    from skyrange.optics.ray_index import RayIndex
    from skyrange.vehicle.sight.witness import Sight

SEEN_ADDRESS: Final = 1 << 48
"""Tracks of sight have this and their number as the address: those of senders have 48 bits."""


class Fusion(StrEnum):
    """What an aircraft avoids."""

    RADIO = "radio"
    """The tracks of Remote ID."""
    CONFIRM = "confirm"
    """Those tracks, without the ones at which its sensors looked and saw nothing."""
    SIGHT = "sight"
    """What its sensors see."""
    EITHER = "either"
    """What its sensors see, and the tracks of Remote ID."""


class AircraftSight:
    """Fusion of one aircraft. Deep copies continue alike."""

    def __init__(self, vehicle: str, sight: Sight, fusion: Fusion, city: RayIndex, row: int) -> None:
        """`row` is that of the aircraft's receiver in track tables."""
        self._vehicle = vehicle
        self._row = row
        self._fusion = fusion
        self._gate_m = GATE_SIGMAS * sight.sigma_m
        self._witness = Witness(sight, city)
        self._seen = SightTracks()

    def receive(
        self,
        now: Time,
        scan: RangeScan,
        motion: tuple[Floats, Floats],
        tracks: TrackTable,
        out: Outbox,
        *,
        cause: FrameId,
    ) -> None:
        """Take in a scan, when the aircraft is at a position with a velocity (`motion`), (3,) each."""
        if self._fusion is Fusion.RADIO:
            return
        beams = self._witness.place_beams(scan, *motion, now)
        at_ns = min(scan.start_ns, now)
        heard = take_heard(tracks.snapshot(self._row, at_ns, include_impossible=True))
        for change in self._witness.look(now, scan.sensor, beams, heard):
            self._note(change, out, cause)
        if self._fusion in (Fusion.SIGHT, Fusion.EITHER):
            known = heard.pos_enu_m if self._fusion is Fusion.EITHER else np.empty((0, 3))
            for seen in self._seen.update(at_ns, beams, self._witness.city, known, self._gate_m):
                tracks.place(self._row, SEEN_ADDRESS + seen.number, seen.at_ns, seen.position, seen.velocity)

    def _note(self, change: Change, out: Outbox, cause: FrameId) -> None:
        address, uas_id = change.key
        data: dict[str, Scalar] = {
            "track": printable_id(uas_id.decode("latin-1")),
            "address": f"{address:012x}",
            "verdict": str(change.verdict),
            "away_m": change.away_m,
            "looks": change.looks,
        }
        out.note("event.sight", self._vehicle, data, (cause,))

    def apply(self, now: Time, tracks: TrackTable, *, keep: bool) -> None:
        """Mark the tracks that avoidance does not believe; with `keep`, besides those that are marked."""
        if self._fusion is Fusion.RADIO:
            return
        row = self._row
        self._witness.forget(now)
        if not keep:
            tracks.ignore(row, _nobody)
        heard = take_heard(tracks.snapshot(row, now, include_impossible=True))
        if self._fusion is Fusion.SIGHT:
            tracks.ignore_slots(row, heard.slot.tolist())
        elif self._fusion is Fusion.CONFIRM:
            verdicts = [self._witness.verdict(key) for key in list_keys(heard)]
            slots = zip(heard.slot.tolist(), verdicts, strict=True)
            tracks.ignore_slots(row, [slot for slot, verdict in slots if verdict is Verdict.NOT_SEEN])


def take_heard(tracks: TrackSnapshot) -> TrackSnapshot:
    """The tracks of senders, without those of sight."""
    rows = np.flatnonzero(tracks.address < SEEN_ADDRESS)
    columns: list[Any] = [column[rows] for column in tracks]
    return TrackSnapshot(*columns)


def _nobody(address: int) -> bool:
    return False
