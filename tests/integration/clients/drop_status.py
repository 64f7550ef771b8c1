"""A tap's program that takes every SYS_STATUS off its link: `drop_status.py HOST:PORT`."""

import json
import socket
import sys

SYS_STATUS = "010000"
"""Bytes 7 to 9 of a MAVLink 2 frame."""

host, _, port = sys.argv[1].rpartition(":")
with socket.create_connection((host, int(port))) as line, line.makefile("rwb", buffering=0) as lines:
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    for said in lines:
        heard = json.loads(said)
        if "id" not in heard:
            continue
        status = heard["payload"][14:20] == SYS_STATUS
        lines.write(json.dumps({"id": heard["id"], "do": "drop" if status else "pass"}).encode() + b"\n")
        if status:
            print("dropped", heard["id"], flush=True)
