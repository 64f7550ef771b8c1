"""Parameters of a radio engine as its greeting carries them."""

from __future__ import annotations

from skyrange.contracts.params import Params


def encode_params(params: Params) -> dict[str, str]:
    """Parameters as texts, without those that are None and without `deadline_s`, which is skyrange's own."""
    values = params.model_dump(exclude_none=True, exclude={"deadline_s"})
    return {name: str(value).lower() if isinstance(value, bool) else str(value) for name, value in values.items()}
