"""A viewer that tells the first position that it sees, and stays: `watch_position.py PORT`."""

import sys

from pymavlink import mavutil

seen = mavutil.mavlink_connection(f"tcp:127.0.0.1:{sys.argv[1]}", source_system=255)
message = seen.recv_match(type="GLOBAL_POSITION_INT", blocking=True, timeout=60)
print(f"SEEN system {message.get_srcSystem()} lat {message.lat} lon {message.lon}", flush=True)
while seen.recv_match(blocking=True, timeout=10) is not None:
    pass
