"""Yardstick of a machine's speed: packing and decoding by pymavlink, to compare machines by."""

from __future__ import annotations

import time

from skyrange.codec.mavlink import dialect as mav

_ROUNDS, _FRAMES = 5, 2000


def yardstick_us() -> float:
    """Microseconds in which pymavlink packs one GLOBAL_POSITION_INT and decodes it again; the best of five rounds.

    Of processor time, as the costs that are compared with it: a program that takes half of the core does not double it.
    """
    link = mav.MAVLink(None, srcSystem=1, srcComponent=1)
    message = mav.MAVLink_global_position_int_message(1000, 473977418, 85455939, 488000, 10000, 100, -200, 5, 9000)
    best = float("inf")
    for _ in range(_ROUNDS):
        began = time.process_time()
        for _ in range(_FRAMES):
            link.decode(bytearray(message.pack(link)))
        best = min(best, time.process_time() - began)
    return best / _FRAMES * 1e6
