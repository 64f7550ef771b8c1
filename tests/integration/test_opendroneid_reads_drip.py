"""Does opendroneid-core-c, the reference library, decode every message of a run with DRIP as skyrange does?"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from skyrange.codec.f3411 import Authentication, BasicId, Location, MessagePack, MessageType, decode
from skyrange.codec.f3411.messages import SingleMessage
from skyrange.record import RunRecord
from tests.drip_range import broadcasts, flown
from tests.tiers import needs_opendroneid

pytestmark = needs_opendroneid
DECODER = Path(__file__).parent / "opendroneid_decoder.c"


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return flown(tmp_path_factory.mktemp("drip") / "run", duration_s=70.0)


def built(folder: Path) -> Path:
    """The decoder, built on the library's sources."""
    library = Path(os.environ["OPENDRONEID"]) / "libopendroneid"
    program = folder / "decoder"
    command = ["cc", "-O1", f"-I{library}", str(DECODER), str(library / "opendroneid.c")]
    # the library puts functions for Wi-Fi frames into another file, among them that which reads packs
    command += [str(library / "wifi.c"), "-lm", "-o", str(program)]
    subprocess.run(command, check=True, capture_output=True, text=True, timeout=120)
    return program


def expected(message: SingleMessage, raw: bytes) -> str:
    """What the decoder prints of a message that skyrange decoded."""
    text = f" {raw[0] >> 4}"
    if isinstance(message, BasicId):
        uas_id = message.uas_id.encode("latin-1").ljust(20, bytes(1))
        return f"{text}:{message.id_type}:{uas_id.hex()}"
    if isinstance(message, Location):
        return f"{text}:{message.lat_deg or 0.0:.7f}:{message.lon_deg or 0.0:.7f}"
    if isinstance(message, Authentication):
        first = (message.last_page or 0, message.length or 0, message.timestamp_s or 0)
        head = ":".join(str(part) for part in (message.auth_type, message.page, *first))
        return f"{text}:{head}:{message.data.hex()}"
    return text


def test_every_message_is_decoded_alike(record: RunRecord, tmp_path: Path) -> None:
    bodies = [frame.body for _, frame in broadcasts(record)]
    given = "".join(f"{body.hex()}\n" for body in bodies)
    done = subprocess.run([built(tmp_path)], input=given, capture_output=True, text=True, check=True, timeout=120)
    lines = done.stdout.splitlines()
    assert len(lines) == len(bodies)
    kinds = set()
    for body, line in zip(bodies, lines, strict=True):
        message = decode(body)
        parts = message.messages if isinstance(message, MessagePack) else (message,)
        raws = [body[at : at + 25] for at in range(3, len(body), 25)] if isinstance(message, MessagePack) else [body]
        head = str(int(MessageType.MESSAGE_PACK)) if isinstance(message, MessagePack) else ""
        assert line == head + "".join(expected(part, raw) for part, raw in zip(parts, raws, strict=True))
        kinds |= {type(part).__name__ for part in parts}
    assert kinds == {"BasicId", "Location", "System", "Authentication"}
