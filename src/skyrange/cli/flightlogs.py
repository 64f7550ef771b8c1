"""The command that makes a scenario from a log of a flight."""

from __future__ import annotations

from pathlib import Path

from rich.table import Table

from skyrange.cli.output.console import print_json, print_notice, print_text, terminal
from skyrange.core.errors import InputError
from skyrange.core.files import expand_user


def import_flight(
    file: Path, number: int | None, system: int | None, vehicle: str | None, out: Path | None, *, as_json: bool
) -> None:
    """`skyrange import`."""
    from skyrange.flightlog.conversion import convert_flight
    from skyrange.flightlog.flights import split_flights
    from skyrange.flightlog.page import describe_flight, write_page
    from skyrange.flightlog.reading import read_log

    log = read_log(file, system, vehicle)
    flights = split_flights(log)
    who = str(log.path)
    if not flights:
        hint = "; ".join(remark.text for remark in log.remarks)
        raise InputError.one(who, "flights", "none", "positions that leave the ground while the vehicle is armed", hint)
    if number is None:
        chosen = max(flights, key=lambda flight: flight.landing_s - flight.take_off_s)
    elif 1 <= number <= len(flights):
        chosen = flights[number - 1]
    else:
        raise InputError.one(who, "--flight", str(number), f"a flight from 1 to {len(flights)}")
    stem = "".join(letter if letter.isalnum() else "-" for letter in log.path.stem).strip("-").lower() or "flight"
    name = f"{stem[:40]}-{chosen.number}"
    folder = Path(name) if out is None else expand_user(out)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError.one("--out", "folder", str(folder), "a new or an empty folder")
    conversion = convert_flight(chosen, name)
    try:
        scenario = conversion.write(folder)
        page = write_page(conversion, flights, folder)
    except OSError as error:
        raise InputError.one("--out", "folder", str(folder), "a folder that can be written", str(error)) from error
    if as_json:
        print_json(
            {
                "scenario": str(scenario),
                "page": str(page),
                "flight": chosen.number,
                "flights": len(flights),
                "facts": [
                    {"kind": fact.kind, "subject": fact.subject, "value": fact.value, "reason": fact.reason}
                    for fact in conversion.facts
                ],
            }
        )
        return
    table = Table(title=f"{log.path.name}: {log.firmware or log.format}", title_justify="left", title_style="bold")
    for column in ("flight", "from", "airborne", "modes", "mission"):
        table.add_column(column)
    for flight in flights:
        table.add_row(*describe_flight(flight), style="bold" if flight is chosen else None)
    terminal().print(table)
    for kind in ("estimated", "assumed", "ignored"):
        for fact in conversion.facts:
            if fact.kind == kind:
                value = fact.value if len(fact.value) <= 80 else f"{fact.value[:79]}…"
                print_text(f"{kind:9}  {fact.subject}: {value or fact.reason}")
    if number is None and len(flights) > 1:
        print_notice(f"flight {chosen.number} is the longest of {len(flights)}; choose another with --flight")
    print_text(f"scenario {scenario}")
    print_text(f"page     {page}")
