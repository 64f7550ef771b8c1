"""MAVLink source detector: frames from unknown senders, commands from no ground station, and replies without a request.

It reads the headers of all MAVLink frames at a link end, the source that each claims on the network, and the contents
of COMMAND_LONG, COMMAND_INT and COMMAND_ACK. The rules, for each link end:

- `mavlink.source.unknown`: a frame from a (system id, component id) that is not declared in `sources`, and that did not
  send during the first `learn_s` (MAVLink's ids of a sender: mavlink.io, Serialization). The first frame counts.
- `mavlink.source.endpoint`: a frame from a network source that did not send during the first `learn_s`.
- `mavlink.source.command`: a frame towards the autopilot that orders something (`ORDERS`), from a system id that is not
  in `ground_systems`. 255 is the id of a ground station by MAVLink's convention (mavlink.io, Routing).
- `mavlink.source.reply`: a COMMAND_ACK for a command that nobody sent the other way at this end within `reply_s`, or a
  MISSION_ACK without a mission transfer the other way. The command and the mission protocol allow neither. This finds
  orders that were injected beyond this end. The default is twice the 5 s after which a ground station that repeats a
  command gives up on it, as an assumption.

The score is the number of such frames since there was none for `quiet_s`. It cannot detect a sender that claims the ids
and the address of a known one, one that sends during `learn_s`, and an injected order that the operator gave as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Final

import numpy as np
from pydantic import BeforeValidator

import skyrange.plugin as sky
from skyrange.detect.messages import MessageHeads, message_numbers
from skyrange.detect.streams import EventCounts, StreamNumbers

RULES: Final = ("unknown", "endpoint", "command", "reply")
ORDERS: Final = (
    "COMMAND_LONG", "COMMAND_INT", "SET_MODE", "MISSION_COUNT", "MISSION_CLEAR_ALL", "MISSION_SET_CURRENT",
    "MISSION_WRITE_PARTIAL_LIST", "PARAM_SET", "SET_HOME_POSITION", "SET_GPS_GLOBAL_ORIGIN", "SET_ATTITUDE_TARGET",
    "SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT", "RC_CHANNELS_OVERRIDE", "MANUAL_CONTROL",
    "SETUP_SIGNING",
)  # fmt: skip
"""Messages that order something of an autopilot."""
_TRANSFER: Final = (
    "MISSION_COUNT", "MISSION_ITEM", "MISSION_ITEM_INT", "MISSION_CLEAR_ALL", "MISSION_WRITE_PARTIAL_LIST",
    "MISSION_SET_CURRENT",
)  # fmt: skip
"""Messages that a MISSION_ACK replies to."""
_MISSION, _NOTHING = -1, -2
"""What MISSION_ACK acknowledges, in place of the number of a command."""


@sky.detector("mavlink.source")
class MessageSource(sky.MessageDetector):
    """Raises an alert for MAVLink frames of unknown senders, commands of no ground station, and unasked replies."""

    learn_s: sky.Number = sky.param(
        "Time from the start in which every sender counts as known, in seconds.", default=10.0, ge=0.0, le=86_400.0
    )
    sources: Annotated[
        tuple[tuple[sky.Whole, sky.Whole], ...], BeforeValidator(sky.items, json_schema_input_type=list[list[int]])
    ] = sky.param(
        "Senders known from the start, as pairs of system id and component id, such as [255, 190].", default=()
    )
    ground_systems: Annotated[tuple[sky.Whole, ...], BeforeValidator(sky.items, json_schema_input_type=list[int])] = (
        sky.param("System ids of ground stations, which may command.", default=(255,))
    )
    reply_s: sky.Number = sky.param(
        "Longest time from a request to its last acknowledgement, in seconds.", default=10.0, gt=0.0, le=3600.0
    )
    known: StreamNumbers = sky.state(StreamNumbers)
    endpoints: set[tuple[int, str]] = sky.state(set)
    requested: dict[tuple[int, bool, int], sky.Time] = sky.state(dict)
    counts: EventCounts

    def prepare(self, context: sky.DetectorContext) -> None:
        """Count frames until there is none for `quiet_s`."""
        self.counts = EventCounts(sky.from_seconds(self.quiet_s))

    def judge(self, now: sky.Time, frames: sky.ObservedFrames, heads: MessageHeads) -> Sequence[sky.Alert]:
        """Read the frames since the last service. Returns an alert for each sender that begins or doubles."""
        orders = np.isin(heads.messages, [message_numbers()[name] for name in ORDERS])
        rows_by_rule = [
            self._unknown(heads),
            self._endpoint(heads, frames),
            np.flatnonzero(orders & heads.to_vehicle & ~np.isin(heads.systems, self.ground_systems)),
            self._replies(heads, frames),
        ]
        places = np.concatenate(rows_by_rule)
        rules = np.repeat(np.arange(len(rows_by_rule)), [len(part) for part in rows_by_rule])
        order = np.argsort(places, kind="stable")
        events, rules = heads.take(places[order]), rules[order]
        streams = self.number(events.senders * len(RULES) + rules)
        return self.alerts(
            frames, events, streams, self.counts.add(events.at_ns, streams),
            lambda row: (RULES[int(rules[row])], {"source": frames.names[int(frames.src[events.rows[row]])][:100]}),
        )  # fmt: skip

    def _unknown(self, heads: MessageHeads) -> sky.Ints:
        """Rows of unknown senders; those within the time to learn become known."""
        self.known.assign(heads.senders[heads.at_ns <= sky.from_seconds(self.learn_s)])
        declared = np.isin(
            heads.systems << 8 | heads.components, [system << 8 | component for system, component in self.sources]
        )
        return np.flatnonzero((self.known.find(heads.senders) < 0) & ~declared)

    def _endpoint(self, heads: MessageHeads, frames: sky.ObservedFrames) -> sky.Ints:
        """Rows of unknown network sources, likewise."""
        learn_ns = sky.from_seconds(self.learn_s)
        names = frames.src[heads.rows]
        known = np.ones(len(names), dtype=np.bool_)
        keys, inverse = np.unique(heads.places * len(frames.names) + names, return_inverse=True)
        for number, key in enumerate(keys.tolist()):
            place, name = divmod(key, len(frames.names))
            pair = place, frames.names[name]
            if pair in self.endpoints:
                continue
            rows = np.flatnonzero(inverse == number)
            if heads.at_ns[rows[0]] <= learn_ns:
                self.endpoints.add(pair)
            else:
                known[rows] = False
        return np.flatnonzero(~known)

    def _replies(self, heads: MessageHeads, frames: sky.ObservedFrames) -> sky.Ints:
        """Rows of acknowledgements that nobody asked for; keeps the times of requests."""
        messages, reply_ns = message_numbers(), sky.from_seconds(self.reply_s)
        subjects = np.full(len(frames), _NOTHING, dtype=np.int64)
        asks = np.zeros(len(frames), dtype=np.bool_)
        for name in ("COMMAND_LONG", "COMMAND_INT", "COMMAND_ACK", "MISSION_ACK"):
            if (heads.messages == messages[name]).any():
                acks = sky.read_messages(frames, name)
                subject = _MISSION if name == "MISSION_ACK" else acks.values["command"].astype(np.int64)
                if name.endswith("ACK"):  # those for a companion pass here as well, but not what it asked for
                    target = acks.values["target_system"]
                    ours = (target == 0) | (target != acks.systems)
                    subjects[acks.rows] = np.where(ours, subject, _NOTHING)
                else:
                    subjects[acks.rows], asks[acks.rows] = subject, True
        subjects, asks = subjects[heads.rows], asks[heads.rows]
        transfer = np.isin(heads.messages, [messages[name] for name in _TRANSFER])
        subjects[transfer] = _MISSION
        set_mode = heads.messages == messages["SET_MODE"]
        subjects[set_mode] = messages["SET_MODE"]  # ArduPilot acknowledges it by COMMAND_ACK with the message's number
        asks |= transfer | set_mode
        unasked = []
        for row in np.flatnonzero(subjects >= _MISSION).tolist():
            place, to_vehicle, subject = int(heads.places[row]), bool(heads.to_vehicle[row]), int(subjects[row])
            at = int(heads.at_ns[row])
            if asks[row]:
                self.requested[place, to_vehicle, subject] = at
            elif at - self.requested.get((place, not to_vehicle, subject), -reply_ns - 1) > reply_ns:
                unasked.append(row)
        return np.array(unasked, dtype=np.int64)
