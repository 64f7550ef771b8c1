"""Comparison of secrets that others send."""

from __future__ import annotations

import hmac


def is_same_secret(sent: str, secret: str) -> bool:
    """Whether two texts are the same, in a time that does not tell how far they agree."""
    return hmac.compare_digest(sent.encode("utf-8", "surrogatepass"), secret.encode())
