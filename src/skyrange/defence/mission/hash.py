"""Mission hash: missions that a station uploads carry a keyed hash, and an aircraft takes no item without its own.

The station's end follows the uploads that leave. For each frame that writes a mission, fence or rally points it sends a
TUNNEL with a keyed hash (HMAC-SHA-256) of the upload as far as that frame: its number, count and all items. The
aircraft's end holds such a frame until the hash of what it has let pass so far, and of this frame, is there and right.
As every prefix of an upload is verified, an autopilot that stores items as they arrive, as ArduPilot does, has no item
that the station did not send at that place. Where no hash comes, the aircraft's end asks: a lost TUNNEL is sent again,
and a frame that the station's end has not sent is forged or altered.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import skyrange.plugin as sky
from skyrange.codec.mavlink import dialect as mav
from skyrange.defence.bases.link_ends import STATION, role_of
from skyrange.defence.mission.hash_ends import COMPONENT, WRITES, AircraftEnd, StationEnd, derive_key
from skyrange.defence.path_rules import ends_at
from skyrange.defence.placement import Alarm, DefenceTap, Protection, find_links


@sky.defence(
    "mission.hash",
    surface=("gcs", "log", "autopilot"),
    place="both ends of the gcs link, or the station's end and the proxy's end of the autopilot link; share a key, and "
    "know the frames that pass",
    effect="holds each frame of an upload until its hash is right, so the autopilot stores no item that the station "
    "has not sent at that place",
    alerts=("mission.forged", "mission.hash", "mission.unanswered", "mission.malformed", "mission.incomplete"),
    against=("mavlink.mission_alter", "mavlink.mission_replace", "mavlink.mission_clear", "mavlink.fence"),
    evasion="commands a place, a mode or another item of the verified mission instead, or is nearer to the autopilot "
    "than where hashes are verified; cuts an upload short in flight",
    cost="a TUNNEL frame of up to 77 bytes for each frame of an upload; a round trip where one is lost",
    nominal=("inject", "drop"),
    realism={
        "the keyed hash": "simulated",
        "keys": "assumed: shared before the flight, and not known to an attacker",
    },
)
class MissionHash(Protection):
    """Verifies uploads of missions, fences and rally points by a keyed hash that their station sends."""

    at: Literal["companion", "proxy"] = sky.param(
        "Where hashes are verified: companion, at its end of the gcs link, or proxy, at its end of the autopilot link, "
        "where what is altered on board is noticed too.",
        default="companion",
    )
    passphrase: str = sky.param(
        "What the key of each aircraft is derived from; both ends have it before the flight.",
        default="skyrange", min_length=1, max_length=256, strict=True,
    )  # fmt: skip
    patience_s: sky.Number = sky.param(
        "Time in seconds after which a frame without an answer about it raises an alarm; the default is how long "
        "ArduPilot waits for an item of an upload.",
        default=8.0, ge=1, le=60,
    )  # fmt: skip

    def build(self, context: sky.DefenceContext) -> sky.Defence:
        """Taps at both ends. Raises `InputError` for aircraft that the scenario does not have."""
        vehicles = self.find_protected(context)
        role, tunnel = role_of(self.at), frozenset((mav.MAVLINK_MSG_ID_TUNNEL,))
        taps, rules = [], list[sky.PathRule]()
        for where, side in (("gcs", "gcs"), (role, self.at)):
            for link, vehicle in find_links(where, vehicles, context).items():
                make = MakeEnd(self, side == "gcs", vehicle, context.vehicles[vehicle].system_id)
                taps.append(sky.TapPlacement(link, side, make, inspects=_is_hashed))
        for station, aircraft in zip(ends_at("gcs", "gcs", vehicles), ends_at(role, self.at, vehicles), strict=True):
            rules += [
                sky.Sends(station, "fwd", tunnel, until=aircraft),
                sky.Sends(aircraft, "rev", tunnel, until=station),
            ]
            rules += [sky.Compares(station, aircraft, "fwd"), sky.Holds(aircraft, "fwd")]
        return sky.Defence(
            taps=taps, exclusive=[sky.Exclusive(f"mission hash of {vehicle}") for vehicle in vehicles], path_rules=rules
        )


@dataclass(frozen=True, slots=True)
class MakeEnd:
    """Makes one of the two ends of a link."""

    kind: MissionHash
    at_station: bool
    vehicle: str
    system: int

    def __call__(self, link: str) -> DefenceTap:
        """The tap of a link."""
        key = derive_key(self.kind.passphrase, self.vehicle)
        if self.at_station:
            return StationEnd(
                link, key, self.system, sky.MavlinkPacker(STATION, COMPONENT)
            )  # until the station has sent a frame
        alarm, patience_ns = Alarm(self.vehicle), sky.from_seconds(self.kind.patience_s)
        return AircraftEnd(
            link, key, self.system, sky.MavlinkPacker(self.system, COMPONENT), alarm, self.kind.schedule, patience_ns
        )


def _is_hashed(frame: sky.Frame) -> bool:
    """Whether a hash is computed of a frame: of an upload, or one that carries a hash."""
    number = sky.message_id(frame.payload)
    return number == mav.MAVLINK_MSG_ID_TUNNEL or (frame.direction == "fwd" and number in WRITES)
