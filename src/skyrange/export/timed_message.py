"""A message of an MCAP file before it is written, and the JSON of a time and of a colour in it."""

from __future__ import annotations

from typing import NamedTuple

from skyrange.core.time import NS_PER_S, Time


class TimedMessage(NamedTuple):
    """One message: its simulated time in ns, its topic, the name of its schema, and its JSON."""

    time_ns: Time
    topic: str
    schema: str
    json: str


def time_json(unix_ns: int) -> str:
    """A time in ns since 1970 as Foxglove's object of seconds and nanoseconds."""
    seconds, rest = divmod(unix_ns, NS_PER_S)
    return f'{{"sec":{seconds},"nsec":{rest}}}'


def color_json(colour: str, opacity: float = 1.0) -> str:
    """A colour `#rrggbb` as Foxglove's object of four numbers from 0 to 1."""
    red, green, blue = (int(colour[place : place + 2], 16) / 255.0 for place in (1, 3, 5))
    return f'{{"r":{red:.4f},"g":{green:.4f},"b":{blue:.4f},"a":{opacity:g}}}'
