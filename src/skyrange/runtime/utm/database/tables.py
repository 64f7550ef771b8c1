"""Tables of the databases of UTM services, as the newest migration leaves them.

Times are nanoseconds since 1970 UTC, heights metres above the ellipsoid; cells and volumes are JSON.
"""

from __future__ import annotations

from typing import Final

from sqlalchemy import BigInteger, Boolean, Column, Float, Integer, MetaData, String, Table, Text

METADATA: Final = MetaData()
_ID = 64
_NAME = 256
_URL = 8_192


def _extent() -> list[Column[object]]:
    return [
        Column("cells", Text, nullable=False),
        Column("lower_m", Float, nullable=False),
        Column("upper_m", Float, nullable=False),
        Column("start_ns", BigInteger, nullable=False),
        Column("end_ns", BigInteger, nullable=False),
    ]


def _reference() -> list[Column[object]]:
    return [
        Column("id", String(_ID), primary_key=True),
        Column("manager", String(_NAME), nullable=False),
        Column("version", Integer, nullable=False),
        Column("ovn", String(_NAME), nullable=False),
        Column("uss_base_url", String(_URL), nullable=False),
    ]


DSS_INTENTS: Final = Table(
    "dss_intents",
    METADATA,
    *_reference(),
    Column("state", String(16), nullable=False),
    Column("subscription_id", String(_ID), nullable=False),
    *_extent(),
)
DSS_CONSTRAINTS: Final = Table("dss_constraints", METADATA, *_reference(), *_extent())
DSS_SUBSCRIPTIONS: Final = Table(
    "dss_subscriptions",
    METADATA,
    Column("id", String(_ID), primary_key=True),
    Column("manager", String(_NAME), nullable=False),
    Column("uss_base_url", String(_URL), nullable=False),
    Column("version", String(_NAME), nullable=False),
    Column("notification_index", Integer, nullable=False),
    Column("is_implicit", Boolean, nullable=False),
    Column("notify_for_operational_intents", Boolean, nullable=False),
    Column("notify_for_constraints", Boolean, nullable=False),
    *_extent(),
)
DSS_AVAILABILITIES: Final = Table(
    "dss_availabilities",
    METADATA,
    Column("id", String(_NAME), primary_key=True),
    Column("state", String(16), nullable=False),
    Column("version", String(_NAME), nullable=False),
)


def _claim() -> list[Column[object]]:
    return [
        Column("operator", String(_NAME), nullable=False),
        Column("vehicle", String(_NAME), nullable=False),
        Column("priority", Integer, nullable=False),
        Column("state", String(16), nullable=False),
        Column("volumes", Text, nullable=False),
    ]


AUTHORITY_INTENTS: Final = Table("authority_intents", METADATA, Column("id", String(_ID), primary_key=True), *_claim())
"""Intents that an authority has accepted."""
USS_INTENTS: Final = Table(
    "uss_intents",
    METADATA,
    *_reference(),
    Column("start_ns", BigInteger, nullable=False),
    Column("end_ns", BigInteger, nullable=False),
    Column("subscription_id", String(_ID), nullable=False),
    Column("reference_state", String(16), nullable=False),
    *_claim(),
)
"""Intents that a USS manages: the reference that the DSS has, and what its operator claims. One that has ended, perhaps
not yet at the DSS, has the state Ended."""
