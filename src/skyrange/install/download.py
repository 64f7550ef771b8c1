"""Download of a file by HTTP or HTTPS, complete or not at all."""

from __future__ import annotations

import http.client
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from email.message import Message
from typing import IO, Final
from urllib.parse import urlsplit

from skyrange.core.errors import ComponentError
from skyrange.core.whole_numbers import parse_whole

TIMEOUT_S: Final = 30.0
"""Timeout in seconds of wall time for connecting and for each read."""

MAX_BYTES: Final = 256 << 20
"""Largest file that is accepted, in bytes."""

_CHUNK_BYTES: Final = 1 << 16

OnProgress = Callable[[int, int | None], None]
"""Called with the number of bytes received and, if known, the total."""


class NotThereError(ComponentError):
    """Raised if the server has no such file."""


class _Redirects(urllib.request.HTTPRedirectHandler):
    """Handler that follows redirects, but never from https to http."""

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
            raise urllib.error.URLError(f"redirects to {newurl}, which is not encrypted")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def download(url: str, into: IO[bytes], on_progress: OnProgress | None = None, hint: str = "") -> None:
    """Write the file at the http or https address `url` to `into`.

    TLS certificates are verified; proxies are taken from the environment (`https_proxy`). Raises `NotThereError` if the
    server does not have the file, and `ComponentError` with `hint` if the server cannot be reached, stops sending or
    closes early. Exceptions of `into` pass through.
    """
    done = 0
    for piece, total in _chunks(url, hint):
        into.write(piece)
        done += len(piece)
        if on_progress is not None:
            on_progress(done, total)


def _chunks(url: str, hint: str) -> Iterator[tuple[bytes, int | None]]:
    """Chunks of the server's answer, each with the total size if the server states it."""
    who = urlsplit(url).netloc
    request = urllib.request.Request(url, headers={"User-Agent": "skyrange"})  # noqa: S310 - the caller's scheme
    done = 0
    total: int | None = None
    try:
        with urllib.request.build_opener(_Redirects).open(request, timeout=TIMEOUT_S) as answer:
            total = _size(answer.headers)
            while piece := answer.read(_CHUNK_BYTES):
                done += len(piece)
                if max(done, total or 0) > MAX_BYTES:
                    raise ComponentError(who, f"sends more than {MAX_BYTES:,} bytes", hint)
                yield piece, total
    except urllib.error.HTTPError as error:
        if error.code in (404, 410):
            raise NotThereError(who, f"does not have {urlsplit(url).path}") from None
        raise ComponentError(who, f"answered {error.code} {error.reason} to {url}", hint) from None
    except urllib.error.URLError as error:
        raise ComponentError(who, f"cannot be reached: {error.reason}", hint) from None
    except TimeoutError:
        raise ComponentError(who, f"sent nothing for {TIMEOUT_S:g} s, after {done:,} bytes", hint) from None
    except (http.client.HTTPException, OSError) as error:
        raise ComponentError(who, f"closed the connection after {done:,} bytes: {error!r}", hint) from None
    if total is not None and done < total:
        raise ComponentError(who, f"closed the connection after {done:,} of {total:,} bytes", hint)


def _size(headers: Message) -> int | None:
    """The Content-Length that the server states, if it is a number."""
    return parse_whole(headers.get("Content-Length", ""))
