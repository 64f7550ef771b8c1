"""Operations of F3548's interface: their methods and paths, and checks of the bodies of requests and responses.

Bodies are checked against the types of the package `uas_standards`, of F3548's interface and of others. These are made
into pydantic's once, so that a body is checked at the speed of compiled code, and fields, their names and their
enumerations stay those of the package. Text that the package leaves open is limited, because it comes from strangers.
"""

from __future__ import annotations

import re
import types
from enum import Enum
from functools import cache
from typing import Annotated, Any, Final, NamedTuple, NotRequired, Union, get_args, get_origin, get_type_hints

from implicitdict import ImplicitDict, StringBasedDateTime
from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError, with_config
from typing_extensions import TypedDict
from uas_standards.astm.f3548.v21.api import OPERATIONS, OperationID

from skyrange.codec.json_errors import describe
from skyrange.codec.web_urls import is_web_url
from skyrange.core.errors import DecodeError
from skyrange.core.time import parse_rfc3339

MAX_TEXT: Final = 8_192
MAX_ITEMS: Final = 10_000
"""Longest list: that of vertices, OiMaxVertices."""


def _check_time(value: str) -> str:
    parse_rfc3339(value)
    return value


def _check_base_url(value: str) -> str:
    if not is_web_url(value):
        raise ValueError("a URL such as https://uss.example.com is needed, without query, fragment and user")
    return value


def _lower(value: str | None) -> str | None:
    return value if value is None else value.lower()


_Text = Annotated[str, Field(max_length=MAX_TEXT, pattern=r"^[^\x00]*$")]
_Moment = Annotated[str, Field(max_length=40), AfterValidator(_check_time)]
_Number = Annotated[float, Field(allow_inf_nan=False)]
_Whole = Annotated[int, Field(ge=-(2**53), le=2**53)]
_MARKS: Final = {
    "uss_base_url": AfterValidator(_check_base_url),
    # UUIDs are the same in upper case (RFC 9562, 4)
    **dict.fromkeys(("id", "operational_intent_id", "constraint_id", "subscription_id"), AfterValidator(_lower)),
}
"""What holds for fields of a name, beyond the types of the package."""
_PLAIN: Final = {str: _Text, float: _Number, int: _Whole, bool: bool, StringBasedDateTime: _Moment}


def check(body: Any, model: type[Any]) -> dict[str, Any]:
    """`body` if it is one of `model`, an `ImplicitDict`: known fields only, enumerations as their members.

    Raises `DecodeError`.
    """
    try:
        return _adapter(model).validate_python(body)  # type: ignore[arg-type]
    except ValidationError as error:
        raise describe(error) from error


@cache
def _adapter(model: type[Any]) -> TypeAdapter[dict[str, Any]]:
    return TypeAdapter(_typed(model))  # type: ignore[arg-type]


@cache
def _typed(model: type[Any]) -> Any:
    """A typed dictionary with the fields of a type of the package."""
    fields: dict[str, Any] = {}
    for name, hint in get_type_hints(model).items():
        given = _pydantic(hint)
        if name in _MARKS:
            given = Annotated[given, _MARKS[name]]
        is_optional = type(None) in get_args(hint) or hasattr(model, name)
        fields[name] = NotRequired[given] if is_optional else given
    return with_config(ConfigDict(extra="ignore"))(TypedDict(model.__name__, fields))  # type: ignore[operator]


def _pydantic(hint: Any) -> Any:
    if hint in _PLAIN:
        return _PLAIN[hint]
    origin = get_origin(hint)
    if origin is list:
        return Annotated[list[_pydantic(get_args(hint)[0])], Field(max_length=MAX_ITEMS)]  # type: ignore[misc]
    if origin in (Union, types.UnionType):
        return Union[tuple(arg if arg is type(None) else _pydantic(arg) for arg in get_args(hint))]  # noqa: UP007
    if hint is dict:
        return dict[str, Any]
    if isinstance(hint, type) and issubclass(hint, ImplicitDict):
        return _typed(hint)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return hint
    raise TypeError(f"no check is known for {hint!r}")


_ID = r"[0-9a-fA-F]{8}-[0-9a-fA-F]{4}-4[0-9a-fA-F]{3}-[89abAB][0-9a-fA-F]{3}-[0-9a-fA-F]{12}"
"""UUIDv4Format."""
_TEXT = r"[A-Za-z0-9_.=+-]{1,128}"
_PATTERNS = {"entityid": _ID, "subscriptionid": _ID}


class Operation(NamedTuple):
    """One operation that a request names."""

    id: OperationID
    parameters: dict[str, str]
    """Those of the path, by the names that the standard gives them; UUIDs in lower case."""


def find_operation(method: str, path: str) -> Operation | None:
    """The operation that a request asks for; `None` if there is none."""
    for operation, verb, pattern in _patterns():
        match = pattern.fullmatch(path) if verb == method else None
        if match is not None:
            found = match.groupdict()
            return Operation(
                operation, {name: text.lower() if name in _PATTERNS else text for name, text in found.items()}
            )
    return None


def path_of(operation: OperationID, **parameters: str) -> tuple[str, str]:
    """The method and the path of an operation."""
    http_operation = OPERATIONS[operation]
    return http_operation.verb, http_operation.path.format(**parameters)


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
    patterns = []
    for operation, http_operation in OPERATIONS.items():
        text = re.sub(
            r"\{(\w+)\}", lambda match: f"(?P<{match[1]}>{_PATTERNS.get(match[1], _TEXT)})", http_operation.path
        )
        patterns.append((operation, http_operation.verb, re.compile(text)))
    return patterns
