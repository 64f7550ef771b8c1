"""Operations of F3548's interface: which one a method and a path name, and its parameters in the path."""

from __future__ import annotations

import re
from functools import cache
from typing import Any, NamedTuple

from uas_standards.astm.f3548.v21.api import OPERATIONS, OperationID

from skyrange.codec.f3548.schemas import check
from skyrange.core.errors import DecodeError

_ID = r"[0-9a-f]{8}-[0-9a-f]{4}-4[0-9a-f]{3}-[89ab][0-9a-f]{3}-[0-9a-f]{12}"
"""UUIDv4Format."""
_TEXT = r"[A-Za-z0-9_.=+-]{1,128}"
_PATTERNS = {"entityid": _ID, "subscriptionid": _ID}


class Operation(NamedTuple):
    """One operation that a request names."""

    id: OperationID
    parameters: dict[str, str]
    """Those of the path, by the names that the standard gives them."""


def find_operation(method: str, path: str) -> Operation | None:
    """The operation that a request asks for; `None` if there is none."""
    for operation, verb, pattern in _patterns():
        found = pattern.fullmatch(path) if verb == method else None
        if found is not None:
            return Operation(operation, found.groupdict())
    return None


def path_of(operation: OperationID, **parameters: str) -> tuple[str, str]:
    """The method and the path of an operation."""
    one = OPERATIONS[operation]
    return one.verb, one.path.format(**parameters)


def check_request(operation: OperationID, body: Any) -> dict[str, Any]:
    """The body of a request, empty where there is to be none. Raises `DecodeError`."""
    model = OPERATIONS[operation].request_body_type
    return {} if model is None else check(body, model)


def check_response(operation: OperationID, status: int, body: Any) -> dict[str, Any]:
    """The body of a response, empty where the standard has none for the status.

    Raises `DecodeError` for another body, and for a success that the operation does not have.
    """
    models = OPERATIONS[operation].response_body_type
    if status < 400 and status not in models:
        raise DecodeError(f"status {status} is none of {operation.value}")
    model = models.get(status)
    return {} if model is None else check(body, model)


@cache
def _patterns() -> list[tuple[OperationID, str, re.Pattern[str]]]:
    found = []
    for operation, one in OPERATIONS.items():
        text = re.sub(r"\{(\w+)\}", lambda match: f"(?P<{match[1]}>{_PATTERNS.get(match[1], _TEXT)})", one.path)
        found.append((operation, one.verb, re.compile(text)))
    return found
