"""Scalars: the values that notes and alerts have as details."""

from __future__ import annotations

Scalar = str | int | float | bool | None
