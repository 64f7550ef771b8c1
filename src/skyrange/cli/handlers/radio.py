"""The commands `skyrange radio map` and `radio show`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skyrange.cli.output.console import print_json, print_notice, print_text
from skyrange.core.errors import InputError

if TYPE_CHECKING:
    from skyrange.city.city import City
    from skyrange.radio.propagation.loss_table_file import LossTableFile
    from skyrange.radio_map.mapping import Place


@dataclass(frozen=True, slots=True)
class MapRequest:
    """The arguments of `skyrange radio map`; empty heights are the defaults."""

    scenario: str | None
    out: Path
    buildings: Path | None
    area: tuple[float, float, float, float] | None
    spacing_m: float
    heights_m: tuple[float, ...]
    transmitter_spacing_m: float
    transmitter_heights_m: tuple[float, ...]
    frequency_mhz: float
    reflections: int
    diffraction: bool
    samples: int


@dataclass(frozen=True, slots=True)
class PictureRequest:
    """The picture to draw; none without a path."""

    path: Path | None
    transmitter: int
    height_m: float | None


def map_losses(request: MapRequest, picture: PictureRequest, changes: Sequence[str], as_json: bool) -> None:
    """`skyrange radio map`."""
    from skyrange.cli.output.progress import map_progress
    from skyrange.core.files import expand_user
    from skyrange.radio_map.mapping import prepare_map, trace_map
    from skyrange.radio_map.places import MapLayout
    from skyrange.radio_map.sionna import SionnaTracer, TraceSettings, check_installed, describe_tracer

    settings = TraceSettings(request.frequency_mhz, request.reflections, request.diffraction, request.samples)
    settings.check()
    city, fixed = _city_and_receivers(request, changes)
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
    _tell(content, out, picture, as_json)


def _city_and_receivers(request: MapRequest, changes: Sequence[str]) -> tuple[City, list[Place]]:
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

    scenario = load(request.scenario, changes, buildings=request.buildings)
    city = build_city(scenario)
    if city is None:
        raise InputError.one(
            "radio map", "city", "none", "a scenario with buildings", "Add [city], or --buildings FILE."
        )
    placed = apply_placing(scenario, city)
    return city, [receiver.place for receiver in (placed.radio.receivers if placed.radio is not None else ())]


def show(path: Path, picture: PictureRequest, as_json: bool) -> None:
    """`skyrange radio show`."""
    from skyrange.core.files import expand_user
    from skyrange.radio.propagation.loss_table_file import read_loss_table

    path = expand_user(path)
    content = read_loss_table(path)
    _check_picture(picture, len(content.places_enu_m))
    _draw(content, (), picture)
    _tell(content, path, picture, as_json)


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
    from skyrange.figures.coverage_map import draw_coverage_map

    drawn = draw_coverage_map(content, city, picture.transmitter, picture.height_m)
    try:
        drawn.save(picture.path)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError.one("picture", str(picture.path), reason, "a file that can be written") from None


def _tell(content: LossTableFile, path: Path, picture: PictureRequest, as_json: bool) -> None:
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
