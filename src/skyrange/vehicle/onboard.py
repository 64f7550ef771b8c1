"""What else is on board? Proxy and companion as declared routes, and the links that tie an aircraft together.

Up: autopilot → proxy → companion → ground station; down the same way back. The proxy also copies to `rid_data` what
the Remote ID broadcast is made of. What passes between companion and the air is `vehicle.companion`'s.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.agent.links import Channel, LinkSpec, Route
from skyrange.agent.payloads import Payloads
from skyrange.codec.columns import message_ids
from skyrange.codec.mavlink import dialect, message_id
from skyrange.core.ids import endpoint, link_name
from skyrange.core.time import NS_PER_MS, NS_PER_US, Time

PROXY_SERVICE_NS: Final[Time] = 0
"""A MAVLink router (mavlink-router, MAVProxy) waits for its sockets: it forwards when a frame comes."""
COMPANION_SERVICE_NS: Final[Time] = 10 * NS_PER_MS
"""The onboard program polls in its own loop."""

ORACLE: Final = "oracle"
"""The endpoint that stands for the environment: what is broadcast goes there, what is received comes from there."""

_ON_BOARD: Final = Channel(mode="reliable", latency_ns=100 * NS_PER_US)
CHANNELS: Final = {
    "gcs": Channel(mode="datagram", latency_ns=20 * NS_PER_MS),
    "log": _ON_BOARD,
    "autopilot": _ON_BOARD,
    "rid_data": _ON_BOARD,
    "rid_up": _ON_BOARD,
    "rid_down": _ON_BOARD,
}
"""Default channel of each kind of link: UDP over a cellular network, and TCP or ZeroMQ within one computer."""

RID_MESSAGES: Final = frozenset(
    (
        dialect.MAVLINK_MSG_ID_HEARTBEAT,
        dialect.MAVLINK_MSG_ID_SYSTEM_TIME,
        dialect.MAVLINK_MSG_ID_GPS_RAW_INT,
        dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        dialect.MAVLINK_MSG_ID_HOME_POSITION,
        dialect.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT,
        dialect.MAVLINK_MSG_ID_OPEN_DRONE_ID_LOCATION,
    )
)
"""What an ASTM F3411 broadcast is made of: status, time, position above the ellipsoid, velocity, take-off.

And where the autopilot flies to, for the companion's avoidance; and the Location that it may make itself."""


class _ForRemoteId:
    """Whether a frame is one that goes to `rid_data`; looks at the header only."""

    def __call__(self, payload: bytes) -> bool:
        return message_id(payload) in RID_MESSAGES

    def rows(self, payloads: Payloads) -> NDArray[np.bool_]:
        """The same of many."""
        found: NDArray[np.bool_] = _IS_RID[np.minimum(message_ids(payloads), len(_IS_RID) - 1)]
        return found

    def __deepcopy__(self, memo: object) -> _ForRemoteId:
        return self


_IS_RID: Final = np.array([number in RID_MESSAGES for number in range(max(RID_MESSAGES) + 2)])
"""By message id; the last stands for all that are higher."""
for_remote_id: Final = _ForRemoteId()


def routes(vehicle: str) -> list[Route]:
    """What proxy and companion of a vehicle forward, all of it unaltered."""
    proxy, companion = endpoint(vehicle, "proxy"), endpoint(vehicle, "companion")
    autopilot, log = link_name("autopilot", vehicle), link_name("log", vehicle)
    gcs, rid_data = link_name("gcs", vehicle), link_name("rid_data", vehicle)
    return [
        Route(proxy, autopilot, log, PROXY_SERVICE_NS),
        Route(proxy, autopilot, rid_data, PROXY_SERVICE_NS, for_remote_id),
        Route(proxy, log, autopilot, PROXY_SERVICE_NS),
        Route(companion, log, gcs, COMPANION_SERVICE_NS),
        Route(companion, gcs, log, COMPANION_SERVICE_NS),
    ]


def links(vehicle: str, operator: str) -> list[LinkSpec]:
    """The four links of one vehicle and its operator's ground station, with default channels."""
    ends = {
        "gcs": (endpoint(operator, "gcs"), endpoint(vehicle, "companion")),
        "log": (endpoint(vehicle, "companion"), endpoint(vehicle, "proxy")),
        "autopilot": (endpoint(vehicle, "proxy"), endpoint(vehicle, "autopilot")),
        "rid_data": (endpoint(vehicle, "proxy"), endpoint(vehicle, "companion")),
    }
    return [LinkSpec(link_name(kind, vehicle), a, b, CHANNELS[kind]) for kind, (a, b) in ends.items()]


def air_links(vehicle: str) -> list[LinkSpec]:
    """The two between one vehicle's companion and the oracle, with default channels."""
    ends = {"rid_up": (endpoint(vehicle, "companion"), ORACLE), "rid_down": (ORACLE, endpoint(vehicle, "companion"))}
    return [LinkSpec(link_name(kind, vehicle), a, b, CHANNELS[kind]) for kind, (a, b) in ends.items()]
