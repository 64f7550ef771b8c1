"""On-board network of an aircraft: proxy and companion as declared routes, and the links that connect them.

Upwards: autopilot → proxy → companion → ground station; downwards the reverse. The proxy also copies to `rid_data`
what the Remote ID broadcast is made of. What passes between companion and oracle is `vehicle.companion`'s.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect, message_id
from skyrange.codec.mavlink.message_columns import message_ids
from skyrange.contracts.frames import Payloads
from skyrange.contracts.links import Channel, LinkSpec, Route
from skyrange.core.ids import endpoint, link_name
from skyrange.core.time import NS_PER_MS, NS_PER_US, Time

PROXY_SERVICE_NS: Final[Time] = 0
"""A MAVLink router (mavlink-router, MAVProxy) blocks on its sockets: it forwards a frame when it arrives."""
COMPANION_SERVICE_NS: Final[Time] = 10 * NS_PER_MS
"""The companion's program polls in its own loop."""

ORACLE: Final = "oracle"
"""The endpoint of the environment oracle: broadcasts are sent to it, and receptions come from it."""

_ON_BOARD: Final = Channel(mode="reliable", latency_ns=100 * NS_PER_US)
CHANNELS: Final = {
    "gcs": Channel(mode="datagram", latency_ns=20 * NS_PER_MS),
    "log": _ON_BOARD,
    "autopilot": _ON_BOARD,
    "rid_data": _ON_BOARD,
    "rid_up": _ON_BOARD,
    "rid_down": _ON_BOARD,
    "scan": _ON_BOARD,
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

Also the autopilot's current target, for the companion's avoidance, and the Location that an autopilot may make itself.
"""


class _ForRemoteId:
    """Whether a frame goes to `rid_data`; reads the header only."""

    def __call__(self, payload: bytes) -> bool:
        return message_id(payload) in RID_MESSAGES

    def rows(self, payloads: Payloads) -> NDArray[np.bool_]:
        """The same for many frames."""
        is_remote_id: NDArray[np.bool_] = _IS_RID[np.minimum(message_ids(payloads), len(_IS_RID) - 1)]
        return is_remote_id

    def __deepcopy__(self, memo: object) -> _ForRemoteId:
        return self


_IS_RID: Final = np.array([number in RID_MESSAGES for number in range(max(RID_MESSAGES) + 2)])
"""By message id; the last element stands for all higher ids."""
for_remote_id: Final = _ForRemoteId()


def onboard_routes(vehicle: str) -> list[Route]:
    """The routes of a vehicle's proxy and companion, which forward frames unaltered."""
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


def onboard_links(vehicle: str, operator: str) -> list[LinkSpec]:
    """The four links of one vehicle and its operator's ground station, with default channels."""
    ends = {
        "gcs": (endpoint(operator, "gcs"), endpoint(vehicle, "companion")),
        "log": (endpoint(vehicle, "companion"), endpoint(vehicle, "proxy")),
        "autopilot": (endpoint(vehicle, "proxy"), endpoint(vehicle, "autopilot")),
        "rid_data": (endpoint(vehicle, "proxy"), endpoint(vehicle, "companion")),
    }
    return [LinkSpec(link_name(kind, vehicle), a, b, CHANNELS[kind]) for kind, (a, b) in ends.items()]


def oracle_links(vehicle: str) -> list[LinkSpec]:
    """The two links between one vehicle's companion and the oracle, with default channels."""
    ends = {"rid_up": (endpoint(vehicle, "companion"), ORACLE), "rid_down": (ORACLE, endpoint(vehicle, "companion"))}
    return [LinkSpec(link_name(kind, vehicle), a, b, CHANNELS[kind]) for kind, (a, b) in ends.items()]


def scan_link(vehicle: str) -> LinkSpec:
    """The link on which the scans of one vehicle's sensors reach its companion, with its default channel."""
    return LinkSpec(link_name("scan", vehicle), ORACLE, endpoint(vehicle, "companion"), CHANNELS["scan"])
