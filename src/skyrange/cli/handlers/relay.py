"""The command `skyrange relay`: serves viewers beside a run until the run ends, then prints what they were shown."""

from __future__ import annotations

from skyrange.cli.addresses import parse_address
from skyrange.cli.output.console import print_notice


def relay(run: str, vehicles: int, listen: str, wait_s: float) -> None:
    """`skyrange relay`."""
    from skyrange.cli.output.viewer_notices import viewer_counts_text
    from skyrange.runtime.viewers import FIRST_PORT, ViewerRelay

    source = parse_address("relay", "--from", run, FIRST_PORT)
    with ViewerRelay(source, parse_address("relay", "--listen", listen, FIRST_PORT), vehicles) as relaying:
        try:
            relaying.serve(wait_s, print_notice)
        except KeyboardInterrupt:
            print_notice("relay: closed")
        print_notice(viewer_counts_text(relaying.counts))
