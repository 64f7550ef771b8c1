"""Declaration of the commands `skyrange radio`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from skyrange.cli import radio
from skyrange.cli.options import AsJson, Buildings, Changes, complete_scenario

radio_app = typer.Typer(
    help="Compute the losses of a city with a ray tracer, and draw them.\n\n"
    "Example: skyrange radio map rid-city -o losses.parquet",
    no_args_is_help=True,
)

Picture = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Also draw the map of one transmitter, as SVG.", show_default=False)
]
At = Annotated[
    int, typer.Option(metavar="N", min=0, help="Transmitter of the picture; 0 is the first ground receiver if any.")
]
Height = Annotated[
    float | None,
    typer.Option(metavar="M", help="Height of the picture; the nearest one of the map is drawn. Default: the lowest."),
]


@radio_app.command("map", epilog="Example: skyrange radio map rid-city -o losses.parquet --picture losses.svg")
def map_losses(
    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="[NAME|FILE]",
            help="Name of a shipped scenario or a TOML file; its ground receivers are transmitters of the map. "
            "Default: the buildings alone.",
            autocompletion=complete_scenario,
            show_default=False,
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="File of the loss table.")] = Path(
        "losses.parquet"
    ),
    buildings: Buildings = None,
    area: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(
            metavar="WEST SOUTH EAST NORTH", help="Edges of the area in metres. Default: those of the buildings."
        ),
    ] = None,
    spacing: Annotated[float, typer.Option(metavar="M", help="Spacing of the receivers in metres.")] = 10.0,
    height: Annotated[
        list[float] | None,
        typer.Option(metavar="M", help="Height of receivers. May be repeated. Default: 1.5, 30, 60, 90 and 120 m."),
    ] = None,
    transmitter_spacing: Annotated[
        float, typer.Option(metavar="M", help="Spacing of the transmitters in metres.")
    ] = 100.0,
    transmitter_height: Annotated[
        list[float] | None,
        typer.Option(metavar="M", help="Height of the grid of transmitters. May be repeated. Default: 60 m."),
    ] = None,
    frequency: Annotated[float, typer.Option(metavar="MHZ", help="Frequency in MHz.")] = 2437.0,
    reflections: Annotated[int, typer.Option(metavar="N", help="Most reflections of a path.")] = 3,
    diffraction: Annotated[bool, typer.Option("--diffraction/--no-diffraction", help="Diffraction at edges.")] = True,
    samples: Annotated[
        int, typer.Option(metavar="N", help="Rays for each transmitter and height; more give less noise.")
    ] = 1_000_000,
    picture: Picture = None,
    picture_transmitter: At = 0,
    picture_height: Height = None,
    changes: Changes = None,
    as_json: AsJson = False,
) -> None:
    """Trace a city with Sionna RT and write a loss table, on which scenarios fly with losses = "table".

    Run it again to continue a map that was interrupted.
    """
    radio.map_losses(
        radio.MapRequest(
            scenario,
            out,
            buildings,
            area,
            spacing,
            tuple(height or ()),
            transmitter_spacing,
            tuple(transmitter_height or ()),
            frequency,
            reflections,
            diffraction,
            samples,
        ),
        radio.PictureRequest(picture, picture_transmitter, picture_height),
        changes or [],
        as_json,
    )


@radio_app.command(epilog="Example: skyrange radio show losses.parquet --picture losses.svg --height 60")
def show(
    table: Annotated[Path, typer.Argument(metavar="FILE", help="A loss table.", show_default=False)],
    picture: Picture = None,
    transmitter: At = 0,
    height: Height = None,
    as_json: AsJson = False,
) -> None:
    """Print what a loss table covers and where it comes from, and draw it without the buildings."""
    radio.show(table, radio.PictureRequest(picture, transmitter, height), as_json)
