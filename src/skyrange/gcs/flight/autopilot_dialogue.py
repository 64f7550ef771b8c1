"""Dialogue of a ground station with one autopilot: commands one after another, and lists of items, until both are done.

It knows nothing of the flight: the flight sequencer says what is to be sent, and is told what has come of it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple

from skyrange.codec.mavlink import Message, Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.mailboxes import Turn
from skyrange.core.ids import Port
from skyrange.core.time import NEVER, Time
from skyrange.gcs.protocols.commands import Command, CommandExchange
from skyrange.gcs.protocols.mission_transfer import Download, ItemList, Transfer, Upload

STATION_SYSTEM = 255
STATION_COMPONENT = mav.MAV_COMP_ID_MISSIONPLANNER
"""190, the component id of ground stations by convention."""
AUTOPILOT_COMPONENT = mav.MAV_COMP_ID_AUTOPILOT1


class Progress(NamedTuple):
    """What has come of commands: one is awaited or was begun, all are done, or a required one is rejected."""

    state: Literal["waiting", "begun", "done", "rejected"]
    reason: str = ""
    """Of a rejection."""


_WAITING: Final = Progress("waiting")
_BEGUN: Final = Progress("begun")
_DONE: Final = Progress("done")


@dataclass(slots=True)
class AutopilotDialogue:
    """What is sent to one autopilot, and what is still to be sent. Deep-copyable.

    Notes: `decision.command_refused` about the aircraft, {reason}, once for each reason of an optional command.
    """

    vehicle: str
    system_id: int
    port: Port
    packer: Packer
    lists: list[ItemList] = field(default_factory=list)
    """What is still to be uploaded."""
    transfer: Transfer | None = None
    upload: Upload | None = None
    exchange: CommandExchange | None = None
    commands: list[Command] = field(default_factory=list)
    """What is sent after the command that is awaited."""
    refused: set[str] = field(default_factory=set)
    """Reasons for rejections of optional commands that are already recorded."""

    @property
    def due(self) -> Time:
        """When something is sent again."""
        due = NEVER
        if self.transfer is not None:
            due = min(due, self.transfer.due)
        if self.exchange is not None:
            due = min(due, self.exchange.due)
        return due

    def send(self, turn: Turn, messages: Iterable[Message]) -> None:
        """Send messages to the aircraft."""
        for message in messages:
            turn.send(self.port, self.packer.pack(message))

    # --- commands ------------------------------------------------------------------------------------------

    def command(self, turn: Turn, commands: Iterable[Command]) -> Progress:
        """Give these commands in place of those that were to be given."""
        self.commands = list(commands)
        return self._give_next(turn)

    def drop_commands(self) -> None:
        """Await no command, and give no more."""
        self.exchange = None
        self.commands = []

    def repeat_command(self, turn: Turn) -> Progress:
        """Send the current command (again) if it is due."""
        exchange = self.exchange
        if exchange is None or turn.now < exchange.due:
            return _WAITING
        return self._send_command(turn, exchange)

    def read_command_ack(self, turn: Turn, message: Message) -> Progress:
        """Read a COMMAND_ACK, which may concern another command or another station."""
        exchange = self.exchange
        if exchange is None or message.command != exchange.command.command:
            return _WAITING
        if message.target_system not in (0, STATION_SYSTEM):
            return _WAITING
        answer = exchange.on_ack(turn.now, message.result)
        if answer == "accepted":
            return self._give_next(turn)
        return _WAITING if answer == "wait" else self._reject(turn, exchange, answer)

    def _give_next(self, turn: Turn) -> Progress:
        if not self.commands:
            self.exchange = None
            return _DONE
        self.exchange = CommandExchange(self.commands.pop(0))
        self.exchange.begin(turn.now)
        progress = self._send_command(turn, self.exchange)
        return _BEGUN if progress is _WAITING else progress

    def _send_command(self, turn: Turn, exchange: CommandExchange) -> Progress:
        action = exchange.on_time(turn.now)
        if action == "send":
            self.send(turn, [exchange.message(self.system_id, AUTOPILOT_COMPONENT)])
        elif action != "wait":
            return self._reject(turn, exchange, action)
        return _WAITING

    def _reject(self, turn: Turn, exchange: CommandExchange, reason: str) -> Progress:
        if not exchange.command.optional:
            return Progress("rejected", reason)
        if reason not in self.refused:
            self.refused.add(reason)
            turn.note("decision.command_refused", self.vehicle, {"reason": reason})
        return self._give_next(turn)

    # --- transfers -----------------------------------------------------------------------------------------

    def upload_next(self, turn: Turn) -> bool:
        """Begin to upload the next list; returns whether there is one."""
        if not self.lists:
            return False
        following = self.lists.pop(0)
        self.upload = Upload(following.items, self.system_id, AUTOPILOT_COMPONENT, following.kind)
        self._begin(turn, self.upload)
        return True

    def read_back(self, turn: Turn) -> None:
        """Begin to read what was uploaded."""
        if self.upload is not None:
            self._begin(turn, Download(self.upload.items, self.system_id, AUTOPILOT_COMPONENT, self.upload.kind))

    def end_transfers(self) -> None:
        """Await no transfer any more."""
        self.transfer = self.upload = None

    def repeat_transfer(self, turn: Turn) -> bool:
        """Send the current message of a transfer again if it is due; returns whether the transfer may have ended."""
        if self.transfer is None or turn.now < self.transfer.due:
            return False
        self.send(turn, self.transfer.on_time(turn.now))
        return True

    def answer_item_request(self, turn: Turn, message: Message) -> None:
        """Send the item that the autopilot requests."""
        if self.upload is not None and _is_of(message, self.upload):
            self.send(turn, self.upload.on_request(turn.now, message.seq))

    def read_mission_ack(self, turn: Turn, message: Message) -> bool:
        """Read a MISSION_ACK; returns whether the transfer may have ended."""
        if self.transfer is None or not _is_of(message, self.transfer):
            return False
        self.transfer.on_ack(turn.now, message.type)
        return True

    def read_count(self, turn: Turn, message: Message) -> bool:
        """Read a MISSION_COUNT; returns whether the transfer may have ended."""
        if not isinstance(self.transfer, Download) or not _is_of(message, self.transfer):
            return False
        self.send(turn, self.transfer.on_count(turn.now, message.count))
        return True

    def read_item(self, turn: Turn, message: Message) -> bool:
        """Read a MISSION_ITEM_INT; returns whether the transfer may have ended."""
        if not isinstance(self.transfer, Download) or not _is_of(message, self.transfer):
            return False
        self.send(turn, self.transfer.on_item(turn.now, message))
        return True

    def _begin(self, turn: Turn, transfer: Transfer) -> None:
        self.transfer = transfer
        self.send(turn, transfer.begin(turn.now))


def _is_of(message: Message, transfer: Transfer) -> bool:
    """Whether a mission message concerns what is transferred, and is addressed to this station."""
    return (
        message.mission_type == transfer.kind
        and message.target_system in (0, STATION_SYSTEM)
        and message.target_component in (0, STATION_COMPONENT)
    )
