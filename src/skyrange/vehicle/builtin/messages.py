"""Handlers of single MAVLink messages: heartbeats, RC overrides, signing keys, list of logs, time.

Heartbeats of ground stations, processed in columns; all other frames of an inbox are left to be read singly. A
heartbeat only shows that its sender is there, and in quiet flight a fleet receives nothing else.

RC overrides: RC_CHANNELS_OVERRIDE and MANUAL_CONTROL, which move the pilot's sticks. After libraries/RC_Channel
(`get_radio_in` and the overrides) and GCS_Common.cpp (`handle_rc_channels_override`, `handle_manual_control`,
`manual_override`).

SETUP_SIGNING: the key with which an autopilot signs its frames and verifies those that it receives. After ArduPilot's
GCS_Signing.cpp (`handle_setup_signing`, `load_signing_key`). Whoever may command the autopilot may give it a key: while
it has none, anybody. An armed one refuses since pull request 10311 of January 2019, which answers issue 10298; it was
first in Copter 4.0 (assumed from the dates). Nothing is acknowledged.

Requests of the list of logs, which an aircraft answers while it is disarmed. After
libraries/AP_Logger/AP_Logger_MAVLinkLogTransfer.cpp: while it is armed it tells once that it is to be disarmed. The
content of logs is read as files (`file_transfer.server`), which no arming prevents; LOG_REQUEST_DATA has no answer.

TIMESYNC: the answer to a request for the time (GCS_Common.cpp `handle_timesync`).
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.message_columns import KIND_TABLES, kind_at, kind_of_message
from skyrange.contracts.frames import Bytes, Ints
from skyrange.contracts.mailboxes import Columns
from skyrange.core.compiled import compiled
from skyrange.core.time import NEVER, from_seconds
from skyrange.vehicle.builtin import pilot
from skyrange.vehicle.builtin.failsafes import ground_station
from skyrange.vehicle.builtin.fleet import RC_CHANNELS, Causes, Fleet, Timer, Vehicle
from skyrange.vehicle.builtin.memory_card import FlightLog
from skyrange.vehicle.builtin.mission import execution
from skyrange.vehicle.builtin.parameters.table import INDEX, MAX_VALUES, MIN_VALUES
from skyrange.vehicle.builtin.pilot import MAX_US, MIN_US

_HEARTBEAT: Final = kind_of_message(dialect.MAVLINK_MSG_ID_HEARTBEAT)
_SYSTEM_ID_OFFSET: Final = 5  # offset of the sender's system id in a frame
_GCS_INDEX: Final = INDEX["SYSID_MYGCS"]


@compiled
def _mark_heartbeats(  # noqa: PLR0917
    now: int, data: Bytes, starts: Ints, sizes: Ints, places: Ints, kinds: NDArray[np.int32], extras: Ints,
    crcs: NDArray[np.uint16], stations: Ints, systems: Ints, heard_ns: Ints, single: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Write to `heard_ns` who heard its ground station; set `single` for all other frames."""
    for row in range(starts.shape[0]):
        place = places[row]
        at = starts[row]
        single[row] = True
        if kind_at(data, at, sizes[row], kinds, extras, crcs) == _HEARTBEAT:
            sender = data[at + _SYSTEM_ID_OFFSET]
            if sender == stations[place] and sender != systems[place]:
                heard_ns[place] = max(now, 1)
                single[row] = False


def consume_heartbeats(fleet: Fleet, mail: Columns) -> Ints:
    """Process the heartbeats of each aircraft's own ground station and return the rows of `mail` that remain.

    Same effect as `failsafes.ground_station.on_heartbeat` for one heartbeat. Heartbeats of other senders remain,
    because they may have to be refused.
    """
    column = fleet.stored_params[:, _GCS_INDEX]
    stations = np.clip(column, MIN_VALUES[_GCS_INDEX], MAX_VALUES[_GCS_INDEX]).astype(np.int64)
    single = np.empty(len(mail.payloads), dtype=np.bool_)
    payloads = mail.payloads
    _mark_heartbeats(
        fleet.now, *payloads.arrays, mail.places, *KIND_TABLES, stations,
        fleet.system_ids, fleet.checks["gcs_heard_ns"], single,
    )  # fmt: skip
    return np.flatnonzero(single)


_IGNORED, _UNSET = 65535, 32767


def on_override(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """RC_CHANNELS_OVERRIDE: microseconds per channel; 0 releases a channel, 65535 leaves it unchanged."""
    if not _accepts_override(fleet, vehicle, peer):
        return
    for channel in range(RC_CHANNELS):
        value = getattr(message, f"chan{channel + 1}_raw")
        if value != _IGNORED:
            _set_override(fleet, vehicle, channel, value)
    _update_overrides(fleet, vehicle, causes)


def on_manual_control(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """MANUAL_CONTROL: x forward, y right and r -1000…1000, z 0…1000, not negative. 32767 releases an axis."""
    if message.target != vehicle.system_id or not _accepts_override(fleet, vehicle, peer) or message.z < 0:
        return
    axes = ((message.y, 1000, 2000), (-message.x, 1000, 2000), (message.z, 0, 1000), (message.r, 1000, 2000))
    for channel, (value, offset, scale) in enumerate(axes):
        us = MIN_US + (MAX_US - MIN_US) * (value + offset) // scale
        _set_override(fleet, vehicle, channel, 0 if abs(value) == _UNSET else us)
    _update_overrides(fleet, vehicle, causes)


def _accepts_override(fleet: Fleet, vehicle: Vehicle, peer: tuple[int, int]) -> bool:
    """Whether overrides of this sender count: only SYSID_MYGCS may move the sticks.

    For the failsafe they count as heartbeats.
    """
    if peer[0] != int(fleet.param(vehicle, "SYSID_MYGCS")):
        return False
    ground_station.mark_seen(fleet, vehicle)
    return fleet.param(vehicle, "RC_OVERRIDE_TIME") != 0.0


def _set_override(fleet: Fleet, vehicle: Vehicle, channel: int, us: int) -> None:
    if us == 0:
        vehicle.rc_overrides.pop(channel, None)
    else:
        vehicle.rc_overrides[channel] = (us, fleet.now)


def on_timer(fleet: Fleet, vehicle: Vehicle) -> None:
    """Release overrides that were not repeated for RC_OVERRIDE_TIME."""
    _update_overrides(fleet, vehicle, ())


def _update_overrides(fleet: Fleet, vehicle: Vehicle, causes: Causes) -> None:
    """Drop expired overrides and update the sticks."""
    holds_s = fleet.param(vehicle, "RC_OVERRIDE_TIME")
    end = NEVER
    if holds_s >= 0.0:
        for channel, (_, since) in list(vehicle.rc_overrides.items()):
            until = since + from_seconds(holds_s)
            if until <= fleet.now:
                del vehicle.rc_overrides[channel]
            else:
                end = min(end, until)
    fleet.set_timer(vehicle, Timer.RC_OVERRIDE, end)
    pilot.update_sticks(fleet, vehicle)
    if pilot.throttle_input(fleet, vehicle) > 0.0 and fleet.armed(vehicle):
        if causes:
            vehicle.target_causes = causes
        if not vehicle.auto_armed:  # a raised throttle allows AUTO to leave the ground (update_auto_armed)
            vehicle.auto_armed = True
            execution.update(fleet, vehicle)


_REFUSAL: Final = "ERROR: Won't setup signing when armed"


def on_setup_signing(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """SETUP_SIGNING: take the key for all channels, from the end of this step on; all zeros end signing.

    ArduPilot takes it between two frames. So frames that arrive within the same 10 ms are verified here as before it.
    """
    if fleet.armed(vehicle):
        fleet.send_text(vehicle, mav.MAV_SEVERITY_WARNING, _REFUSAL, causes)
        return
    secret, timestamp = bytes(message.secret_key), int(message.initial_timestamp)
    signs = bool(timestamp) or any(secret)
    fleet.new_keys.append((vehicle.row, (secret, timestamp) if signs else None))
    fleet.note("event.signing_key", vehicle, {"signs": signs}, causes)


def on_log_request_list(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """LOG_REQUEST_LIST: a LOG_ENTRY for each log of the range, numbered from 1; one of zeros if there is none.

    They are sent at once; ArduPilot sends one in each pass of its loop.
    """
    if fleet.armed(vehicle):
        if not vehicle.log_refused:
            vehicle.log_refused = True
            fleet.send_text(vehicle, mav.MAV_SEVERITY_ERROR, "Disarm for log download", causes)
        return
    vehicle.log_refused = False
    logs = vehicle.card.logs()
    if not logs:
        fleet.send(vehicle, mav.MAVLink_log_entry_message(0, 0, 0, 0, 0), causes)
        return
    last = min(message.end, len(logs))
    for number in range(max(message.start, 1), last + 1):
        entry = logs[number - 1]
        utc_s = entry.content.utc_s if isinstance(entry.content, FlightLog) else 0
        size = len(entry.read())
        fleet.send(vehicle, mav.MAVLink_log_entry_message(number, len(logs), last, utc_s, size), causes)


def on_timesync(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """Answer a request (`tc1` 0) with the time since boot, to which ArduPilot adds its system id."""
    if message.tc1 != 0:
        return
    since_ns = max(fleet.now - int(fleet.boot_ns[vehicle.row]), 0) // 1000 * 1000 + vehicle.system_id
    fleet.send(vehicle, mav.MAVLink_timesync_message(since_ns, message.ts1), causes)
