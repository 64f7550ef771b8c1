"""Messages of ASTM F3548-21 between USSs and a DSS: requests and responses, operations, checked bodies, and values."""
