"""How does a file come from a web server, whole or not at all?"""

from __future__ import annotations

import http.client
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from email.message import Message
from typing import IO, Final
from urllib.parse import urlsplit

from skyrange.core.errors import ComponentError

SILENCE_S: Final = 30.0
"""A server that neither connects nor sends for so long (wall time) is given up."""

MOST_BYTES: Final = 256 << 20
"""A larger file is refused."""

_PIECE: Final = 1 << 16

OnProgress = Callable[[int, int | None], None]
"""Called with the bytes done and, if it is known, their sum."""


class NotThereError(ComponentError):
    """The server has no such file."""


class _Redirects(urllib.request.HTTPRedirectHandler):
    """Follows a server that sends on to another address, but never from https to http."""

    def redirect_request(
        self,
        req: urllib.request.Request,
        fp: IO[bytes],
        code: int,
        msg: str,
        headers: http.client.HTTPMessage,
        newurl: str,
    ) -> urllib.request.Request | None:
        if urlsplit(req.full_url).scheme == "https" and urlsplit(newurl).scheme != "https":
            raise urllib.error.URLError(f"it sends on to {newurl}, which is not encrypted")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def download(url: str, into: IO[bytes], on_progress: OnProgress | None = None, hint: str = "") -> None:
    """Write what stands at `url`, of http or https, to `into`.

    TLS certificates are verified; proxies are those of the environment (`https_proxy`). Raises `NotThereError` if the
    server does not know the address, `ComponentError` (with `hint`) if it is not reached, falls silent or stops early;
    what `into` raises passes through.
    """
    done = 0
    for piece, total in _pieces(url, hint):
        into.write(piece)
        done += len(piece)
        if on_progress is not None:
            on_progress(done, total)


def _pieces(url: str, hint: str) -> Iterator[tuple[bytes, int | None]]:
    """What the server sends, piece by piece, each with the size of the whole if the server said it."""
    who = urlsplit(url).netloc
    request = urllib.request.Request(url, headers={"User-Agent": "skyrange"})  # noqa: S310 - the caller's scheme
    done = 0
    total: int | None = None
    try:
        with urllib.request.build_opener(_Redirects).open(request, timeout=SILENCE_S) as answer:
            total = _size(answer.headers)
            while piece := answer.read(_PIECE):
                done += len(piece)
                if max(done, total or 0) > MOST_BYTES:
                    raise ComponentError(who, f"sends more than {MOST_BYTES:,} bytes", hint)
                yield piece, total
    except urllib.error.HTTPError as error:
        if error.code in (404, 410):
            raise NotThereError(who, f"has no {urlsplit(url).path}") from None
        raise ComponentError(who, f"answered {error.code} {error.reason} to {url}", hint) from None
    except urllib.error.URLError as error:
        raise ComponentError(who, f"cannot be reached: {error.reason}", hint) from None
    except TimeoutError:
        raise ComponentError(who, f"sent nothing more for {SILENCE_S:g} s, after {done:,} bytes", hint) from None
    except (http.client.HTTPException, OSError) as error:
        raise ComponentError(who, f"broke off after {done:,} bytes: {error!r}", hint) from None
    if total is not None and done < total:
        raise ComponentError(who, f"broke off after {done:,} of {total:,} bytes", hint)


def _size(headers: Message) -> int | None:
    """The length that the server states."""
    said = headers.get("Content-Length", "")
    return int(said) if said.isascii() and said.isdigit() else None
