"""What is wrong with JSON that does not fit its model, as a `DecodeError`."""

from __future__ import annotations

from collections.abc import Container

from pydantic import ValidationError

from skyrange.core.errors import DecodeError


def describe(error: ValidationError, hidden: Container[object] = ()) -> DecodeError:
    """What is wrong first, and where; parts of the place that are `hidden`, such as tags of a union, are left out."""
    first = error.errors(include_url=False, include_context=False, include_input=False)[0]
    where = ".".join(str(part) for part in first["loc"] if part not in hidden) or "message"
    return DecodeError(f"{where}: {first['msg']}")
