"""The command `skyrange tap`: serves an external tap until the range ends, then prints what it did."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from skyrange.cli.output.console import print_json, print_notice, print_text


def tap(
    link: str, listen: str, run: Path | None, hold_ms: float, fail: str, name: str, wait_s: float, as_json: bool
) -> None:
    """`skyrange tap`."""
    from pydantic import ValidationError

    from skyrange.core.errors import InputError
    from skyrange.runtime.live.taps.external_tap import TapTerms
    from skyrange.runtime.live.taps.tap_process import TapProcess, parse_loopback

    given: dict[str, Any] = {"link": link, "name": name, "hold_ms": hold_ms, "fail": fail}
    try:
        terms = TapTerms.model_validate(given)
    except ValidationError as error:
        raise InputError.one("tap", "--name", name, "1 to 32 letters, digits, '-' or '_'") from error
    tapping = TapProcess(terms, parse_loopback(listen), run or newest_live_run(), wait_s)
    try:
        tapping.serve(print_notice)
    except KeyboardInterrupt:
        print_notice("tap: removed from the link")
    if as_json:
        print_json(dict(tapping.counts))
    else:
        counted = ", ".join(f"{count} {what}" for what, count in tapping.counts.items())
        print_text(f"{link}: {counted or 'no frames'}")


def newest_live_run() -> Path:
    """The folder of the newest live range under `runs`. Raises `InputError` if there is none."""
    from skyrange.core.errors import InputError
    from skyrange.record.folder import PARTS

    found = sorted(Path("runs").glob(f"*/{PARTS}"), key=lambda path: path.stat().st_mtime)
    if not found:
        raise InputError.one("tap", "--run", "no live range under runs", "the run folder of a live range")
    return found[-1].parent
