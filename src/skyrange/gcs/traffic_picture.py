"""Traffic picture of an operator: Remote ID tracks from its ground receivers, with age and signal strength.

Reports come from the oracle, but anybody can broadcast what they contain. Any bytes are therefore accepted without
failure and counted, and the number of notes about new and lost tracks is bounded.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from skyrange.codec.f3411 import printable_id
from skyrange.codec.f3411.columns import decode_locations
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import Transport
from skyrange.contracts.alerts import Scalar
from skyrange.contracts.frames import Ints, Payloads
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.references import FrameRefTable
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import FrameId
from skyrange.core.time import NEVER, NS_PER_S, Epoch, Time, to_seconds
from skyrange.core.whole_numbers import has_one_worth_noting, worth_noting
from skyrange.radio import ground_receptions
from skyrange.remoteid.tracks import ReceivedBroadcasts, TrackSnapshot, TrackTable

if TYPE_CHECKING:  # its imports are slow, and only receivers that verify need them
    from skyrange.remoteid.drip.verification.verdicts import Verification
    from skyrange.remoteid.drip.verification.verifier import Verifier

UPDATE_PERIOD_NS: Final[Time] = NS_PER_S
"""How often new and lost tracks are determined."""
MAX_NOTED: Final = 256
"""New and lost tracks are noted one by one up to this number, then only the 512th, 1024th …: a bound for floods."""
_COUNTS: Final = ("event.tracks_refused", "event.tracks_displaced", "event.tracks_impossible", "event.bad_frame")

_Claim = tuple[int, int, int, int]
"""Address and identifier that a sender claims, as `remoteid.tracks` stores them."""


class _Known(NamedTuple):
    """Identifier and last reception of a sender whose track was noted as new."""

    uas_id: str
    heard_ns: Time


class TrafficPicture:
    """The tracks of one operator's ground receivers: one row of `tracks` for each of `receivers`. Deep-copyable."""

    def __init__(
        self,
        operator: str,
        receivers: Sequence[str],
        origin: Origin,
        verifications: Sequence[Verification | None] = (),
        epoch: Epoch | None = None,
    ) -> None:
        """`verifications`: how each receiver verifies, if any does; their clocks follow `epoch`."""
        self.operator = operator
        self.receivers = tuple(receivers)
        self.tracks = TrackTable(len(self.receivers), origin)
        self.bad_reports = 0
        """Number of undecodable reports, and of reports with receptions of receivers that are not the operator's."""
        self.bad_bodies = 0
        """Number of broadcasts that cannot be an F3411 message."""
        self.due: Time = NEVER
        """When new and lost tracks are determined next; `NEVER` while there are no tracks."""
        self.verifier = _verifier(verifications, epoch)
        """Verdicts on senders; None if no receiver verifies."""
        self._row_of = {name: row for row, name in enumerate(self.receivers)}
        self._refs = FrameRefTable()
        self._known: dict[_Claim, _Known] = {}
        self._noted = 0
        self._counts = np.zeros(len(_COUNTS), dtype=np.int64)

    def seen(self, receiver: str, now: Time) -> TrackSnapshot:
        """A receiver's tracks with age and signal strength, implausible ones too; `KeyError` if unknown."""
        return self.tracks.snapshot(self._row_of[receiver], now, include_impossible=True)

    def receive_reports(self, now: Time, inbox: Inbox, order: Ints, out: Outbox) -> None:
        """Update the tracks from reports: the arrivals `order` of an inbox, as `Columns.order` numbers them."""
        numbers, serials = self._refs.read(inbox, order)
        frames: list[bytes] = []
        rows: list[tuple[int, int, int, int]] = []  # receiver, end of reception, frame
        for arrival, number, serial in zip(order.tolist(), numbers.tolist(), serials.tolist(), strict=True):
            report = inbox.arrival(arrival)
            try:
                receptions = ground_receptions.decode(report.payload).body
            except DecodeError as error:
                self._bad(str(error), report.ref, out)
                continue
            foreign = [reception.receiver for reception in receptions if reception.receiver not in self._row_of]
            if foreign:
                self._bad(f"receiver {foreign[0][:40]!r}", report.ref, out)
            for reception in receptions:
                if reception.receiver in self._row_of:
                    frame = reception.frame()
                    frames.append(link_payload.pack(frame.header, frame.body))
                    # not later than now, because a track in the future would never become stale
                    at = min(max(reception.time_ns, 0), now)
                    rows.append((self._row_of[reception.receiver], at, number, serial))
        if not rows:
            return
        rid = link_payload.unpack_rows(Payloads.of(frames))
        if self.verifier is not None:
            self._verify(self.verifier, frames, rows)
        receiver, at_ns, ref, serial_of = np.array(rows, dtype=np.int64).T
        locations = decode_locations(rid.bodies)
        self.bad_bodies += int(np.count_nonzero(~locations.valid))
        self.tracks.update(ReceivedBroadcasts(receiver, at_ns, rid, locations, ref, serial_of))
        if self.due == NEVER:
            self.due = now - now % UPDATE_PERIOD_NS + UPDATE_PERIOD_NS

    def _verify(self, verifier: Verifier, frames: Sequence[bytes], rows: Sequence[tuple[int, int, int, int]]) -> None:
        for payload, (receiver, at_ns, number, serial) in zip(frames, rows, strict=True):
            header, body = link_payload.unpack(payload)
            verifier.receive(receiver, at_ns, header.address, header.counter, body, self._refs.id(number, serial))

    def note_changes(self, now: Time, out: Outbox) -> None:
        """Note new tracks and lost tracks, changed verdicts, and changed counters."""
        if self.verifier is not None:
            self.verifier.review(now)
            for change in self.verifier.changes():
                causes = () if change.cause is None else (change.cause,)
                note_data = {"receiver": self.receivers[change.row], **change.data}
                out.note("event.remote_id_trust", self.operator, note_data, causes)
        strongest = self._strongest(now)
        rows = self.tracks.rows
        for claim, (receiver, slot) in strongest.items():
            row = rows[receiver, slot]
            raw = np.array(claim[1:], dtype=np.uint64).tobytes().rstrip(b"\0")
            uas_id = printable_id(raw.decode("latin-1"))
            if claim not in self._known:
                located = row["located_ns"] >= 0
                ref = self._refs.id(int(row["ref"]), int(row["serial"])) if located else None
                data: dict[str, Scalar] = {
                    "receiver": self.receivers[receiver],
                    "uas_id": uas_id,
                    "address": f"{claim[0]:012x}",
                    "transport": Transport(int(row["transport"])).name.lower(),
                    "rssi_dbm": round(float(row["rssi_dbm"]), 2),
                }
                self._note("event.track_seen", data, () if ref is None else (ref,), out)
            heard = max(int(row["heard_ns"]), self._known[claim].heard_ns if claim in self._known else 0)
            self._known[claim] = _Known(uas_id, heard)
        for claim in [claim for claim in self._known if claim not in strongest]:
            lost_track = self._known.pop(claim)
            data = {
                "uas_id": lost_track.uas_id,
                "address": f"{claim[0]:012x}",
                "last_s": to_seconds(lost_track.heard_ns),
            }
            self._note("event.track_lost", data, (), out)
        counts = np.append(self.tracks.counts.sum(axis=0), self.bad_bodies)
        for column, kind in enumerate(_COUNTS):
            if has_one_worth_noting(self._counts.item(column), counts.item(column)):
                out.note(kind, self.operator, {"count": counts.item(column)})
        self._counts = counts
        self.due = now - now % UPDATE_PERIOD_NS + UPDATE_PERIOD_NS if self._known else NEVER

    def _strongest(self, now: Time) -> dict[_Claim, tuple[int, int]]:
        """Every sender that is not stale, with its strongest reception: receiver and slot in that receiver's row."""
        rows = self.tracks.rows
        live = (rows["heard_ns"] >= 0) & (now - rows["heard_ns"] <= self.tracks.stale_ns)
        strongest: dict[_Claim, tuple[int, int]] = {}
        for receiver, slot in np.argwhere(live).tolist():
            row = rows[receiver, slot]
            claim = (int(row["address"]), int(row["id_a"]), int(row["id_b"]), int(row["id_c"]))
            if claim not in strongest or row["rssi_dbm"] > rows[strongest[claim]]["rssi_dbm"]:
                strongest[claim] = (receiver, slot)
        return strongest

    def _note(self, kind: str, data: dict[str, Scalar], causes: tuple[FrameId, ...], out: Outbox) -> None:
        self._noted += 1
        if self._noted <= MAX_NOTED or worth_noting(self._noted):
            out.note(kind, self.operator, {**data, "count": self._noted}, causes)

    def _bad(self, reason: str, ref: FrameId, out: Outbox) -> None:
        self.bad_reports += 1
        if worth_noting(self.bad_reports):
            out.note("event.bad_report", self.operator, {"count": self.bad_reports, "reason": reason}, (ref,))


def _verifier(verifications: Sequence[Verification | None], epoch: Epoch | None) -> Verifier | None:
    if epoch is None or all(verification is None for verification in verifications):
        return None
    from skyrange.remoteid.drip.verification.verifier import Verifier

    verifier = Verifier(verifications)
    for row in verifier.rows:
        verifier.set_clock(row, 0, epoch.utc_us(0))
    return verifier
