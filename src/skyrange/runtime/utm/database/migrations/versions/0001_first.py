"""First version of the tables."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None

_REFERENCE = (
    ("id", sa.String(64)),
    ("manager", sa.String(256)),
    ("version", sa.Integer),
    ("ovn", sa.String(256)),
    ("uss_base_url", sa.String(8_192)),
)
_EXTENT = (
    ("cells", sa.Text),
    ("lower_m", sa.Float),
    ("upper_m", sa.Float),
    ("start_ns", sa.BigInteger),
    ("end_ns", sa.BigInteger),
)
_CLAIM = (
    ("operator", sa.String(256)),
    ("vehicle", sa.String(256)),
    ("priority", sa.Integer),
    ("state", sa.String(16)),
    ("volumes", sa.Text),
)
_TABLES = {
    "dss_intents": (*_REFERENCE, ("state", sa.String(16)), ("subscription_id", sa.String(64)), *_EXTENT),
    "dss_constraints": (*_REFERENCE, *_EXTENT),
    "dss_subscriptions": (
        ("id", sa.String(64)),
        ("manager", sa.String(256)),
        ("uss_base_url", sa.String(8_192)),
        ("version", sa.String(256)),
        ("notification_index", sa.Integer),
        ("is_implicit", sa.Boolean),
        ("notify_for_operational_intents", sa.Boolean),
        ("notify_for_constraints", sa.Boolean),
        *_EXTENT,
    ),
    "dss_availabilities": (("id", sa.String(256)), ("state", sa.String(16)), ("version", sa.String(256))),
    "uss_intents": (
        *_REFERENCE,
        ("start_ns", sa.BigInteger),
        ("end_ns", sa.BigInteger),
        ("subscription_id", sa.String(64)),
        ("reference_state", sa.String(16)),
        *_CLAIM,
    ),
    "authority_intents": (("id", sa.String(64)), *_CLAIM),
}


def upgrade() -> None:
    """Make the tables."""
    for table, columns in _TABLES.items():
        op.create_table(
            table, *(sa.Column(name, kind, primary_key=name == "id", nullable=False) for name, kind in columns)
        )


def downgrade() -> None:
    """Drop the tables."""
    for table in _TABLES:
        op.drop_table(table)
