"""The commands `skyrange radio map` and `radio show`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from skyrange.cli.options import AsJson, Buildings, Changes, complete_scenario
from skyrange.cli.output.console import print_json, print_notice, print_text
from skyrange.core.errors import InputError

if TYPE_CHECKING:
    from skyrange.city.city import City
    from skyrange.radio.propagation.loss_table_file import LossTableFile
    from skyrange.radio_map.mapping import Place


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


class MapRequest(NamedTuple):
    """The arguments of `skyrange radio map`; empty heights are the defaults."""

    scenario: str | None
    out: Path
    buildings: Path | None
    changes: Sequence[str]
    area: tuple[float, float, float, float] | None
    spacing_m: float
    heights_m: tuple[float, ...]
    transmitter_spacing_m: float
    transmitter_heights_m: tuple[float, ...]
    frequency_mhz: float
    reflections: int
    diffraction: bool
    samples: int


class PictureRequest(NamedTuple):
    """The picture to draw; none without a path."""

    path: Path | None
    transmitter: int
    height_m: float | None


@radio_app.command("map", epilog="Example: skyrange radio map rid-city -o losses.parquet --picture losses.svg")
def map_losses(
    *,
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
    request = MapRequest(
        scenario=scenario,
        out=out,
        buildings=buildings,
        changes=changes or (),
        area=area,
        spacing_m=spacing,
        heights_m=tuple(height or ()),
        transmitter_spacing_m=transmitter_spacing,
        transmitter_heights_m=tuple(transmitter_height or ()),
        frequency_mhz=frequency,
        reflections=reflections,
        diffraction=diffraction,
        samples=samples,
    )
    _map_losses(request, PictureRequest(picture, picture_transmitter, picture_height), as_json=as_json)


@radio_app.command(epilog="Example: skyrange radio show losses.parquet --picture losses.svg --height 60")
def show(
    *,
    table: Annotated[Path, typer.Argument(metavar="FILE", help="A loss table.", show_default=False)],
    picture: Picture = None,
    transmitter: At = 0,
    height: Height = None,
    as_json: AsJson = False,
) -> None:
    """Print what a loss table covers and where it comes from, and draw it without the buildings."""
    from skyrange.core.files import expand_user
    from skyrange.radio.propagation.loss_table_file import read_loss_table

    path = expand_user(table)
    content = read_loss_table(path)
    drawing = PictureRequest(picture, transmitter, height)
    _check_picture(drawing, len(content.places_enu_m))
    _draw(content, (), drawing)
    _tell(content, path, drawing, as_json=as_json)


def _map_losses(request: MapRequest, picture: PictureRequest, *, as_json: bool) -> None:
    """`skyrange radio map`."""
    from skyrange.cli.output.progress import map_progress
    from skyrange.core.files import expand_user
    from skyrange.radio_map.mapping import MapLayout, prepare_map, trace_map
    from skyrange.radio_map.sionna import SionnaTracer, TraceSettings, check_installed, describe_tracer

    settings = TraceSettings(
        request.frequency_mhz, request.reflections, diffraction=request.diffraction, samples=request.samples
    )
    settings.check()
    city, fixed = _city_and_receivers(request)
    default = MapLayout(city.bounds)
    layout = MapLayout(
        request.area or city.bounds,
        request.spacing_m,
        request.heights_m or default.heights_m,
        request.transmitter_spacing_m,
        request.transmitter_heights_m or default.transmitter_heights_m,
    )
    check_installed()
    out = expand_user(request.out)
    job = prepare_map(city, layout, fixed, settings.frequency_mhz, describe_tracer(settings), out)
    _check_picture(picture, len(job.places_enu_m))
    grid, finished = job.header.grid.grid, len(job.finished())
    if not as_json:
        heights = ", ".join(f"{height:g}" for height in grid.heights_m)
        print_notice(
            f"{len(job.places_enu_m)} transmitters, {grid.columns} x {grid.rows} receivers {grid.spacing_m:g} m apart "
            f"at {heights} m; {len(city)} buildings"
        )
        if finished:
            print_notice(f"{finished} transmitters are finished in {job.parts}")
    with map_progress("radio map", "transmitters", quiet=as_json) as on_step:
        content = trace_map(job, SionnaTracer(city, settings), on_step)
    _draw(content, city.to_json_rows(), picture)
    _tell(content, out, picture, as_json=as_json)


def _city_and_receivers(request: MapRequest) -> tuple[City, list[Place]]:
    """The buildings, and the places of a scenario's ground receivers."""
    from skyrange.city.building_files import load_buildings
    from skyrange.core.files import expand_user

    if request.scenario is None:
        if request.buildings is None:
            raise InputError.one("radio map", "SCENARIO", "none", "a scenario, or --buildings FILE")
        return load_buildings(expand_user(request.buildings))[0], []
    from skyrange.assembly.city import build_city
    from skyrange.assembly.placement.clear_placing import apply_placing
    from skyrange.scenario.shipped import load

    scenario = load(request.scenario, request.changes, buildings=request.buildings)
    city = build_city(scenario)
    if city is None:
        raise InputError.one(
            "radio map", "city", "none", "a scenario with buildings", "Add [city], or --buildings FILE."
        )
    placed = apply_placing(scenario, city)
    return city, [receiver.place for receiver in (placed.radio.receivers if placed.radio is not None else ())]


def _check_picture(picture: PictureRequest, transmitters: int) -> None:
    if picture.path is None:
        return
    if picture.transmitter >= transmitters:
        raise InputError.one("picture", "transmitter", str(picture.transmitter), f"0 to {transmitters - 1}")
    if picture.path.is_dir() or not picture.path.absolute().parent.is_dir():
        raise InputError.one("picture", "file", str(picture.path), "a file that can be written")


def _draw(content: LossTableFile, city: Sequence[Mapping[str, Any]], picture: PictureRequest) -> None:
    if picture.path is None:
        return
    from skyrange.figures.maps import draw_coverage_map

    drawn = draw_coverage_map(content, city, picture.transmitter, picture.height_m)
    try:
        drawn.save(picture.path)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError.one("picture", str(picture.path), reason, "a file that can be written") from None


def _tell(content: LossTableFile, path: Path, picture: PictureRequest, *, as_json: bool) -> None:
    import numpy as np

    header, grid = content.header, content.header.grid
    share = float(np.isfinite(content.loss_db).mean())
    if as_json:
        facts = {"path": str(path), "transmitters": len(content.places_enu_m), "covered": round(share, 6)}
        print_json({**facts, **header.model_dump(mode="json")})
        return
    heights = ", ".join(f"{height:g}" for height in grid.heights_m)
    tracer = ", ".join(f"{key} {value}" for key, value in header.tracer.items())
    print_text(f"table        {path}")
    print_text(f"transmitters {len(content.places_enu_m)}, reach {header.reach_m:g} m, {header.reach_up_m:g} m up")
    print_text(f"receivers    {grid.columns} x {grid.rows}, {grid.spacing_m:g} m apart, at {heights} m")
    print_text(f"frequency    {header.frequency_mhz:g} MHz")
    print_text(f"covered      {share:.1%} of all pairs; the rest is inside buildings or without a path")
    print_text(f"buildings    SHA-256 {header.buildings}")
    print_text(f"tracer       {tracer}")
    if picture.path is not None:
        print_text(f"picture      {picture.path}")
