"""Sight check: drops broadcasts of aircraft at whose claimed positions LiDARs or depth cameras look and see none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np

import skyrange.plugin as sky
from skyrange.attack.tapped_links import TapMaker
from skyrange.contracts.plugins.form import param_of
from skyrange.defence.bases.receptions import BroadcastJudge
from skyrange.defence.placement import DefenceTap, inspects_none, place_taps
from skyrange.defence.receptions import Claim, Finding, Held, Sender
from skyrange.optics.ray_index import index_city
from skyrange.remoteid.tracks import STALE_S, TrackSnapshot
from skyrange.vehicle.sight.air import list_extinctions
from skyrange.vehicle.sight.evidence import Rates, Verdict
from skyrange.vehicle.sight.scan_reader import ScanReader
from skyrange.vehicle.sight.settings import Air, FalseRate, MissedRate, PositionError
from skyrange.vehicle.sight.witness import Key, Sight, Witness

KIND: Final = "remote_id.sight"
STALE_NS: Final = sky.from_seconds(STALE_S)
"""A position that is older than this is not looked at: the companion's track of it has ended."""


@sky.defence(
    "remote_id.sight",
    surface=("rid_down",),
    place="the companion's ends of rid_down, scan and rid_data; knows the broadcasts received, the scans of its "
    "sensors, its own aircraft's position, and a map of the buildings",
    effect="drops the broadcasts of a sender while nothing is seen where it claims to be, so that avoidance sees no "
    "new position of it; a track that is there ends 10 s later",
    alerts=(KIND,),
    against=("remote_id.spoof", "remote_id.replay", "remote_id.signed_ghost"),
    evasion="claims positions before a wall, outside the field or the range of the sensors, or where something flies",
    cost="a comparison of beams with a gate for each track and scan; no frame and no delay is added, but the aircraft "
    "carry sensors",
    realism={
        "sensors": "simulated from data sheets",
        "building map": "assumed: the receiver has the range's own",
        "size and reflectivity of other aircraft": "assumed: those of an Iris's body",
    },
)
class SightCheck(BroadcastJudge):
    """Drops Remote ID of senders at whose claimed positions the aircraft's sensors have looked and seen nothing.

    The test is that of `fusion = "confirm"` of a companion: see the page on sight.
    """

    decides: ClassVar = "sight check"

    missed: MissedRate = param_of(MissedRate, 0.01)
    false: FalseRate = param_of(FalseRate, 0.01)
    sigma_m: PositionError = param_of(PositionError, 2.5)
    air: Air = param_of(Air, "estimated")
    scans: ScanReader
    witness: Witness
    held: Held = sky.state(Held)
    """The last claim of each sender."""

    def build(self, context: sky.DefenceContext) -> sky.Defence:
        """Taps. Raises `InputError` also for aircraft without sensors."""
        vehicles = [vehicle for vehicle in self.find_protected(context) if context.sensors.get(vehicle)]
        for place, vehicle in enumerate(self.vehicles):
            if vehicle not in vehicles:
                expected = "an aircraft with a LiDAR or a depth camera"
                hint = 'Add sensors = [{ model = "hap" }] to the aircraft.'
                raise sky.InputError.one(context.id, f"vehicles.{place}", vehicle, expected, hint)
        if not vehicles:
            hint = 'Add sensors = [{ model = "hap" }] to an aircraft.'
            raise sky.InputError.one(context.id, "vehicles", "no sensors", "an aircraft with a LiDAR", hint)
        self.vehicles = tuple(vehicles)
        return super().build(context)

    def place_more(self, context: sky.DefenceContext) -> Sequence[sky.TapPlacement]:
        """A tap that looks at the scans of the aircraft."""
        sensors = context.sensors[self.vehicle]
        self.scans = ScanReader({self.vehicle: sensors})
        sight = Sight(sensors, Rates(self.missed, self.false), self.sigma_m, list_extinctions(self.air))
        self.witness = Witness(sight, index_city(context.city))
        scans = TapMaker(_ScanTap, (self,))
        return place_taps("scan", "companion", [self.vehicle], context, scans, inspects_none)

    def judge(self, now: sky.Time, sender: Sender, claim: Claim | None) -> Sequence[sky.Verdict]:
        """Drop the broadcasts of a sender that is not seen; all of its messages, as its Location tells who it is."""
        if claim is not None and claim.place is not None:
            who = Sender(sender.address, "")
            self.held.touch(who)
            self.held.put(who, claim)
        finding = Finding(KIND, 1.0, (("sigma_m", self.sigma_m),))
        return self.refuse(now, sender, finding) if self.witness.verdict(_key(sender)) is Verdict.NOT_SEEN else ()

    def look(self, now: sky.Time, payload: bytes) -> None:
        """Look at the last claims of all senders with the beams of a scan. What is no scan of the aircraft is passed
        over: the companion counts it.
        """
        place = self.own.place_at(now)
        scan = self.scans.read(self.vehicle, payload)
        if place is None or scan is None:
            return
        claims = [claim for claim in self.held.senders.values() if isinstance(claim, Claim)]
        fresh = [claim for claim in claims if 0 <= now - claim.at_ns <= STALE_NS and not claim.grounded]
        self.witness.forget(now)
        if fresh:
            beams = self.witness.place_beams(scan, np.array(place), np.array(self.own.velocity), now)
            self.witness.look(now, scan.sensor, beams, _snapshot(fresh, scan.start_ns))


@dataclass(slots=True)
class _ScanTap(DefenceTap):
    """Hands the scans of an aircraft to its check."""

    check: SightCheck

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> Sequence[sky.Verdict]:
        """Let it pass."""
        if frame.direction == "fwd":
            self.check.look(now, frame.payload)
        return ()


def _key(sender: Sender) -> Key:
    """Senders are told apart by address: an attacker can change the identifier with each message."""
    return int.from_bytes(sender.address, "big"), b""


def _snapshot(claims: Sequence[Claim], at_ns: sky.Time) -> TrackSnapshot:
    """Claims as tracks at a time, which may be before them."""
    count = len(claims)
    places = np.array([claim.place for claim in claims], dtype=np.float64)
    speeds = np.array([claim.velocity or (0.0, 0.0, 0.0) for claim in claims])
    since_s = np.array([(at_ns - claim.at_ns) / sky.NS_PER_S for claim in claims])
    return TrackSnapshot(
        slot=np.arange(count),
        uas_id=np.zeros(count, dtype="S20"),
        address=np.array([_key(claim.sender)[0] for claim in claims], dtype=np.int64),
        pos_enu_m=places + speeds * since_s[:, None],
        vel_enu_mps=speeds,
        age_s=np.maximum(since_s, 0.0),
        rssi_dbm=np.full(count, np.nan),
        status=np.zeros(count, dtype=np.int64),
    )
