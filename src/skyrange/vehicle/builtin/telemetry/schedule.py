"""Schedule of reports: the streams and their rates, which reports are due, and how they are sent.

Each aircraft's reports start at a phase of its own within the interval, as if the aircraft had been switched on at
different times. An aircraft's frames of one moment keep the order of `table.BUILDERS`, as do its sequence numbers.

Message streams: which messages each contains, and their rates at boot, by ArduCopter's table.
libraries/GCS_MAVLink/GCS_MAVLink_Parameters.cpp (`STREAM_…_msgs`), limited to the messages that are sent here, and
`handle_request_data_stream` (GCS_Param.cpp). Without a request only HEARTBEAT is sent, at 1 Hz, since ArduCopter's
rates at boot are 0.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from skyrange.codec.mavlink import dialect
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.message_columns import MessageTable, assign_sequence_numbers, pack_batches
from skyrange.contracts.frames import Ints
from skyrange.core.compiled import compiled
from skyrange.core.time import NEVER, NS_PER_MS, NS_PER_S, Time
from skyrange.vehicle.builtin.fleet import COMPONENT_ID, Fleet, Vehicle
from skyrange.vehicle.builtin.parameters.table import INDEX
from skyrange.vehicle.builtin.telemetry.table import AVAILABLE, BUILDERS, NEVER_SENT, build_table

SERVICE_NS: Final = 10 * NS_PER_MS
COLUMN: Final = {message: column for column, message in enumerate((*BUILDERS, *sorted(NEVER_SENT)))}
"""Column of every message that has an interval; those that can be sent come first."""
_SENT: Final = len(BUILDERS)
_HEARTBEAT: Final = COLUMN[dialect.MAVLINK_MSG_ID_HEARTBEAT]
_IN_ORDER: Final = tuple(BUILDERS)
_NEVER: Final = int(NEVER)


class Batch(NamedTuple):
    """Messages of one type that are due: the aircraft, the contents, and the sequence numbers."""

    message_id: int
    rows: Ints
    values: MessageTable
    sequences: Ints


@compiled
def _take_due(due: Ints, interval: Ints, soonest: Ints, picked: Ints, now: int, rows: Ints, ends: Ints) -> int:  # noqa: PLR0917
    """Write the aircraft that are due, message by message, to `rows`; `ends` are the ends of each message's part.

    Intervals that a message has missed are skipped (GCS_MAVLINK::update_send).
    """
    count = 0
    for column in range(due.shape[1]):
        for place in range(picked.shape[0]):
            row = picked[place]
            if due[row, column] <= now:
                rows[count] = row
                count += 1
                due[row, column] = max(due[row, column] + interval[row, column], now + 1)
        ends[column] = count
    for place in range(picked.shape[0]):
        row = picked[place]
        least = due[row, 0]
        for column in range(1, due.shape[1]):
            least = min(least, due[row, column])
        soonest[row] = least
    return count


class Schedule:
    """When which message of which aircraft is due: (aircraft, message) arrays of nanoseconds.

    `period` is what was asked for; `interval` is longer while an aircraft's streams are slowed.
    """

    __slots__ = ("_delay_ns", "_factor", "_next", "due", "interval", "offset", "period", "soonest")

    def __init__(self, offsets_ns: Ints) -> None:
        """`offsets_ns` (aircraft,): the phase of each aircraft in its intervals, below one second."""
        count = offsets_ns.shape[0]
        self.offset = offsets_ns
        self.period = np.zeros((count, len(COLUMN)), dtype=np.int64)
        self.interval = np.zeros((count, _SENT), dtype=np.int64)
        self.due = np.full((count, _SENT), NEVER, dtype=np.int64)
        self._factor = np.ones(count, dtype=np.int64)
        self._delay_ns = np.zeros(count, dtype=np.int64)
        self.soonest = np.full(count, NEVER, dtype=np.int64)
        self._next: Time = NEVER  # nothing is due before

    def set(self, row: int, message: int, period_ns: Time, now: Time) -> None:
        """Send `message` every `period_ns` from now on, at most once per service; 0 stops it."""
        column = COLUMN[message]
        self.period[row, column] = period_ns
        if column < _SENT:
            slowed_ns = (period_ns + self._delay_ns[row]) * self._factor[row] if period_ns else 0
            self.interval[row, column] = slowed_ns if column != _HEARTBEAT else period_ns
            offset = int(self.offset[row]) % period_ns if period_ns else 0
            self.due[row, column] = now + offset if period_ns else NEVER
            self.soonest[row] = self.due[row].min()
            self._next = min(self._next, int(self.soonest[row]))

    def clear(self, row: int) -> None:
        """Stop all messages, as at power-on."""
        self.period[row] = self.interval[row] = 0
        self._factor[row] = 1
        self._delay_ns[row] = 0
        self.due[row] = NEVER
        self.soonest[row] = NEVER

    def slow(self, row: int, factor: int, delay_ns: Time) -> None:
        """Make the intervals of one aircraft longer than asked for by `delay_ns`, and then `factor` times as long,
        counted from what was sent last.

        HEARTBEAT keeps its own (`deferred_message` of GCS.h).
        """
        self._factor[row] = factor
        self._delay_ns[row] = delay_ns
        asked = self.period[row, :_SENT]
        changed = (asked + delay_ns * (asked > 0)) * factor
        changed[_HEARTBEAT] = self.period[row, _HEARTBEAT]
        sent = self.due[row] < _NEVER
        self.due[row, sent] += (changed - self.interval[row])[sent]
        self.interval[row] = changed
        self.soonest[row] = self.due[row].min()
        self._next = int(self.soonest.min())

    def take(self, fleet: Fleet) -> list[Batch]:
        """Return the messages that are due, with contents and numbers; set their next times."""
        for row in sorted({*fleet.stream_factors, *fleet.stream_delays_ns}):
            factor = fleet.stream_factors.get(row, self._factor.item(row))
            self.slow(row, factor, fleet.stream_delays_ns.get(row, self._delay_ns.item(row)))
        fleet.stream_factors.clear()
        fleet.stream_delays_ns.clear()
        if fleet.now < self._next:
            return []
        (picked,) = (self.soonest <= fleet.now).nonzero()
        rows = np.empty(len(picked) * _SENT, dtype=np.int64)
        ends = np.empty(_SENT, dtype=np.int64)
        _take_due(self.due, self.interval, self.soonest, picked, fleet.now, rows, ends)
        self._next = int(self.soonest.min())
        due_rows: list[tuple[int, Ints]] = []
        start = 0
        for message, end in zip(_IN_ORDER, ends.tolist(), strict=True):
            if end > start:
                message_rows = rows[start:end]
                if message in AVAILABLE:
                    message_rows = message_rows[AVAILABLE[message](fleet, message_rows)]
                if len(message_rows):
                    due_rows.append((message, message_rows))
            start = end
        batches = []
        for message, message_rows in due_rows:
            sequences = np.empty(len(message_rows), dtype=np.int64)
            assign_sequence_numbers(message_rows, fleet.sequences, sequences)
            batches.append(Batch(message, message_rows, build_table(fleet, message, message_rows), sequences))
        return batches

    def send_due(self, fleet: Fleet) -> None:
        """Send all messages that are due and set their next times."""
        batches = self.take(fleet)
        if not batches:
            return
        systems = fleet.system_ids
        payloads = pack_batches([(b.message_id, b.values, systems[b.rows], b.sequences) for b in batches], COMPONENT_ID)
        fleet.outbox.send_block(np.concatenate([batch.rows for batch in batches]), payloads)


STREAMS: Final[dict[int, tuple[str, tuple[int, ...]]]] = {
    mav.MAV_DATA_STREAM_RAW_SENSORS: (
        "SR0_RAW_SENS",
        (
            mav.MAVLINK_MSG_ID_RAW_IMU,
            mav.MAVLINK_MSG_ID_SCALED_IMU2,
            mav.MAVLINK_MSG_ID_SCALED_IMU3,
            mav.MAVLINK_MSG_ID_SCALED_PRESSURE,
            mav.MAVLINK_MSG_ID_SCALED_PRESSURE2,
        ),
    ),
    mav.MAV_DATA_STREAM_EXTENDED_STATUS: (
        "SR0_EXT_STAT",
        (
            mav.MAVLINK_MSG_ID_SYS_STATUS,
            mav.MAVLINK_MSG_ID_POWER_STATUS,
            mav.MAVLINK_MSG_ID_MCU_STATUS,
            mav.MAVLINK_MSG_ID_MEMINFO,
            mav.MAVLINK_MSG_ID_MISSION_CURRENT,
            mav.MAVLINK_MSG_ID_GPS_RAW_INT,
            mav.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT,
            mav.MAVLINK_MSG_ID_FENCE_STATUS,
            mav.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT,
        ),
    ),
    mav.MAV_DATA_STREAM_RC_CHANNELS: (
        "SR0_RC_CHAN",
        (mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW, mav.MAVLINK_MSG_ID_RC_CHANNELS),
    ),
    mav.MAV_DATA_STREAM_RAW_CONTROLLER: ("SR0_RAW_CTRL", ()),
    mav.MAV_DATA_STREAM_POSITION: (
        "SR0_POSITION",
        (mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED),
    ),
    mav.MAV_DATA_STREAM_EXTRA1: (
        "SR0_EXTRA1",
        (mav.MAVLINK_MSG_ID_ATTITUDE, mav.MAVLINK_MSG_ID_AHRS2, mav.MAVLINK_MSG_ID_ESC_TELEMETRY_1_TO_4),
    ),
    mav.MAV_DATA_STREAM_EXTRA2: ("SR0_EXTRA2", (mav.MAVLINK_MSG_ID_VFR_HUD,)),
    mav.MAV_DATA_STREAM_EXTRA3: (
        "SR0_EXTRA3",
        (
            mav.MAVLINK_MSG_ID_AHRS,
            mav.MAVLINK_MSG_ID_RANGEFINDER,
            mav.MAVLINK_MSG_ID_DISTANCE_SENSOR,
            mav.MAVLINK_MSG_ID_SYSTEM_TIME,
            mav.MAVLINK_MSG_ID_TERRAIN_REPORT,
            mav.MAVLINK_MSG_ID_BATTERY_STATUS,
            mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
            mav.MAVLINK_MSG_ID_VIBRATION,
        ),
    ),
}
"""MAV_DATA_STREAM → the parameter of its rate at boot, and its messages."""
MIN_INTERVAL_MS: Final = 3
"""The shortest interval accepted, for a 400 Hz loop; here a message is sent every 10 ms at most."""

_OF_MESSAGE: Final = {message: name for name, messages in STREAMS.values() for message in messages}


def interval_ns(rate_hz: float) -> Time:
    """Return the interval of a rate, in whole milliseconds as in ArduPilot: 0, never, below 1 Hz or over 1 kHz.

    `get_interval_for_stream` and `cap_message_interval` (GCS_Common.cpp): at most 0.8 of the main loop's rate.
    """
    whole_ms = 1000 // int(rate_hz) if rate_hz >= 1.0 else 0
    return max(whole_ms, MIN_INTERVAL_MS) * NS_PER_MS if whole_ms else 0


def start_boot_streams(schedule: Schedule, fleet: Fleet, vehicle: Vehicle) -> None:
    """Start what is sent at boot: HEARTBEAT and Open Drone ID's Location at 1 Hz, streams at their SR0_… rates."""
    schedule.clear(vehicle.row)
    schedule.set(vehicle.row, mav.MAVLINK_MSG_ID_HEARTBEAT, NS_PER_S, fleet.now)
    if fleet.param(vehicle, "DID_ENABLE"):  # AP_OpenDroneID.h, _mavlink_dynamic_period_ms
        schedule.set(vehicle.row, mav.MAVLINK_MSG_ID_OPEN_DRONE_ID_LOCATION, NS_PER_S, fleet.now)
    for name, messages in STREAMS.values():
        period = interval_ns(fleet.param(vehicle, name))
        for message in messages:
            schedule.set(vehicle.row, message, period, fleet.now)


def default_interval_ns(fleet: Fleet, vehicle: Vehicle, message: int) -> Time:
    """Return the default interval of a message; 0 is never."""
    if message == mav.MAVLINK_MSG_ID_HEARTBEAT:
        return NS_PER_S
    return interval_ns(fleet.param(vehicle, _OF_MESSAGE[message])) if message in _OF_MESSAGE else 0


def on_request_data_stream(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, message: Any) -> None:
    """REQUEST_DATA_STREAM: start or stop one stream, or all (0).

    The stream's parameter is set until the next boot.
    """
    if message.start_stop > 1:
        return
    # ArduPilot stores the rate as a signed 16-bit integer: a larger one is negative, and nothing is sent
    requested_hz = message.req_message_rate if message.start_stop == 1 else 0
    rate = requested_hz if requested_hz <= 32_767 else 0
    chosen = STREAMS if message.req_stream_id == mav.MAV_DATA_STREAM_ALL else (message.req_stream_id,)
    for stream in chosen:
        if stream not in STREAMS:
            continue
        name, messages = STREAMS[stream]
        index = INDEX[name]
        vehicle.unsaved_params.setdefault(index, float(fleet.stored_params[vehicle.row, index]))
        fleet.stored_params[vehicle.row, index] = rate
        period = interval_ns(rate)
        for number in messages:
            schedule.set(vehicle.row, number, period, fleet.now)
