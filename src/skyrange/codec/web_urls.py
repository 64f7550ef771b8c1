"""URLs of web services that others name."""

from __future__ import annotations

import re
from urllib.parse import urlsplit


def is_web_url(url: str) -> bool:
    """Whether text is an HTTP URL to which a path can be appended."""
    try:
        parts = urlsplit(url)
        return (
            parts.scheme in ("http", "https")
            and bool(parts.hostname)
            and parts.port != 0
            and "@" not in parts.netloc
            and re.fullmatch(r"[!-~]+", url) is not None
            and not re.search(r"[?#\\\"<>^`{|}]", url)
        )
    except ValueError:
        return False
