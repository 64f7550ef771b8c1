"""Adversary of a campaign: what it has observed, and the stage that it is in.

It reads Remote ID that its radio decodes and MAVLink on links that it taps, and nothing else: no truth. It observes
from the start of the run, muted or not; muting discards its acts and notes alone.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from skyrange.attack.campaign.params import Condition, Sighting, Stage
from skyrange.attack.contract import Place
from skyrange.codec.f3411 import BasicId, Location, MessagePack
from skyrange.codec.f3411 import decode as decode_remote_id
from skyrange.codec.mavlink import decode, dialect, message_id
from skyrange.codec.remote_id import link_payload
from skyrange.contracts.links import Schedule
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import Origin
from skyrange.core.time import Time, from_seconds

_NAMES: Final = {number: message.msgname for number, message in dialect.mavlink_map.items()}
_POSITION: Final = dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
_ITEM: Final = dialect.MAVLINK_MSG_ID_MISSION_CURRENT


@dataclass(slots=True)
class Knowledge:
    """What the adversary has observed."""

    origin: Origin
    by_telemetry: dict[str, Place] = field(default_factory=dict)
    """Last position that each aircraft reported on a tapped link, by vehicle id."""
    by_broadcast: dict[str, Place] = field(default_factory=dict)
    """Last position that each UAS ID claimed in a received broadcast."""
    messages: Counter[str] = field(default_factory=Counter)
    """MAVLink messages seen on tapped links, by name."""
    broadcasts: int = 0
    uas_ids: dict[bytes, str] = field(default_factory=dict)
    """Last UAS ID of each sender address: Bluetooth 4 sends it in another broadcast than the position."""
    items: dict[str, int] = field(default_factory=dict)
    """Current mission item of each aircraft, by vehicle id."""

    def read_frame(self, vehicle: str, payload: bytes) -> None:
        """Learn from a frame on a tapped link of an aircraft; anything that is not MAVLink is passed over."""
        number = message_id(payload)
        if number is None or number not in _NAMES:
            return
        self.messages[_NAMES[number]] += 1
        if number not in (_POSITION, _ITEM):
            return
        try:
            message = decode(payload)
        except DecodeError:
            return
        if number == _ITEM:
            self.items[vehicle] = message.seq
            return
        east_m, north_m = self.origin.enu_of(message.lat * 1e-7, message.lon * 1e-7)
        self.by_telemetry[vehicle] = (east_m, north_m, message.alt * 1e-3 - self.origin.alt_msl_m)

    def read_broadcast(self, payload: bytes) -> None:
        """Learn from a received Remote ID broadcast; anything that cannot be decoded is passed over."""
        try:
            header, body = link_payload.unpack(payload)
            message = decode_remote_id(body)
        except DecodeError:
            return
        self.broadcasts += 1
        parts = message.messages if isinstance(message, MessagePack) else (message,)
        for part in parts:
            if isinstance(part, BasicId):
                self.uas_ids[header.address] = part.uas_id
        for part in parts:
            if isinstance(part, Location) and part.lat_deg is not None and part.lon_deg is not None:
                east_m, north_m = self.origin.enu_of(part.lat_deg, part.lon_deg)
                ground_m = self.origin.ellipsoid_of(self.origin.alt_msl_m)
                up_m = part.alt_geo_m - ground_m if part.alt_geo_m is not None else 0.0
                self.by_broadcast[self.uas_ids.get(header.address, "")] = (east_m, north_m, up_m)

    def sees(self, wanted: Sighting) -> bool:
        """Whether an aircraft that the sighting means was last observed near its place."""
        if wanted.vehicle is not None:
            places = [self.by_telemetry[wanted.vehicle]] if wanted.vehicle in self.by_telemetry else []
        elif wanted.uas_id is not None:
            places = [self.by_broadcast[wanted.uas_id]] if wanted.uas_id in self.by_broadcast else []
        else:
            places = list(self.by_broadcast.values())
        return any(math.dist(place, wanted.place) <= wanted.within_m for place in places)


@dataclass(slots=True)
class Adversary:
    """The state machine of a campaign. All its parts share one."""

    schedule: Schedule
    """When the campaign acts."""
    stages: Sequence[Stage]
    acts: Mapping[str, Schedule]
    """When each act acts, as its parts read it."""
    knowledge: Knowledge
    stage: int = -1
    """Number of the current stage; -1 before the start, that of stages after the end."""
    began_ns: Time = 0
    _messages: Counter[str] = field(default_factory=Counter)
    _broadcasts: int = 0
    entered: list[str] = field(default_factory=list)
    """Stages entered since they were last noted; "end" for the end."""

    def update(self, now: Time) -> None:
        """Go on to the stage that follows from the time and from what was observed, over any number of them."""
        if self.stage < 0:
            if now < self.schedule.start_ns:
                return
            self._enter(0, now)
        while self.stage < len(self.stages):
            stage = self.stages[self.stage]
            if stage.until is not None and self._holds(stage.until, now):
                self._enter(self.stage + 1, now)
            elif stage.timeout_s is not None and now >= self.began_ns + from_seconds(stage.timeout_s):
                self._enter(self.stage + 1 if stage.then == "next" else len(self.stages), now)
            else:
                return

    def acts_now(self, act: str) -> bool:
        """Whether an act acts in the current stage."""
        return 0 <= self.stage < len(self.stages) and act in self.stages[self.stage].acts

    @property
    def over(self) -> bool:
        """Whether the campaign has ended."""
        return self.stage >= len(self.stages)

    def _enter(self, number: int, now: Time) -> None:
        before = set(self.stages[self.stage].acts) if 0 <= self.stage < len(self.stages) else set()
        self.stage, self.began_ns = number, now
        after = set(self.stages[number].acts) if number < len(self.stages) else set()
        for act in before - after:
            self.acts[act].stop_ns = now
        for act in after - before:
            self.acts[act].start_ns, self.acts[act].stop_ns = now, self.schedule.stop_ns
        self._messages, self._broadcasts = self.knowledge.messages.copy(), self.knowledge.broadcasts
        self.entered.append(self.stages[number].name if number < len(self.stages) else "end")

    def _holds(self, until: Condition, now: Time) -> bool:
        if until.after_s is not None and now < self.began_ns + from_seconds(until.after_s):
            return False
        if until.sighting is not None and not self.knowledge.sees(until.sighting):
            return False
        if until.messages and not any(self.knowledge.messages[name] > self._messages[name] for name in until.messages):
            return False
        if until.broadcasts is not None and self.knowledge.broadcasts < self._broadcasts + until.broadcasts:
            return False
        return until.mission_item is None or any(item >= until.mission_item for item in self.knowledge.items.values())
