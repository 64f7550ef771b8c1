"""Sionna RT as the ray tracer of radio maps: a scene of a city, and the losses from one transmitter.

The gain of a point is the sum of the powers of all paths: the local mean that fading varies about. Line of sight is
computed exactly, from the point's own position. Paths of up to `depth` specular reflections, and those with one
diffraction at an edge, come from `RadioMapSolver`, as the mean over the square about the point. Rays that are launched
at random sample them: their error grows with the loss, and a point out of sight that no ray reaches has no value.

Rays hardly cross a horizontal plane at the transmitter's own height. A plane that is nearer to it than `MIN_RISE_M` is
moved away to that distance for reflections and diffraction, and the gain is kept relative to that of free space.

Walls and roofs are concrete, the ground is medium dry ground, with the constants of ITU-R P.2040-3 table 3 as Sionna
has them; no ray passes through a building.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.city.city import City
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.extras import describe_install, require_extra
from skyrange.radio.propagation.loss_table import LossGrid, free_space_of
from skyrange.radio_map.city_mesh import Mesh, city_mesh, ground_mesh

MIN_RISE_M: Final = 3.0
"""At this distance from the transmitter's height rays still cross a plane 500 m away at an angle of a third of a
degree."""
MIN_RAYS: Final = 1.0
"""Reflections count at squares that at least so many rays would cross in free space. At others a ray is a rare event,
which Sionna weights by the reciprocal of its probability: a single one would be stronger than the direct path."""
MAX_LOSS_DB: Final = 150.0
"""Larger losses count as no value: few rays find them, and no link of this band closes over them."""
GROUND_MARGIN_M: Final = 2_000.0
SEED: Final = 1
_LLVM: Final = "DRJIT_LIBLLVM_PATH"
_FOLDERS: Final = ("/usr/lib", "/usr/lib64", "/usr/local/lib", "/opt/homebrew/opt/llvm/lib", "/usr/local/opt/llvm/lib")


@dataclass(frozen=True, slots=True)
class TraceSettings:
    """Settings of the tracer, which are part of a table's provenance."""

    frequency_mhz: float = 2_437.0
    """Wi-Fi channel 6, on which most Remote ID is sent."""
    depth: int = 3
    """Most reflections of a path."""
    diffraction: bool = True
    samples: int = 1_000_000
    """Rays for each transmitter and height."""

    def check(self) -> None:
        """Raise `InputError` for settings outside their range."""
        for name, value, low, high in (
            ("frequency", self.frequency_mhz, 100.0, 100_000.0),
            ("reflections", self.depth, 0, 10),
            ("samples", self.samples, 1_000, 100_000_000),
        ):
            if not low <= value <= high:
                raise InputError.one("radio map", name, f"{value:g}", f"{low:g} to {high:g}")


def find_llvm() -> Path | None:
    """The LLVM library for the CPU: the one of `DRJIT_LIBLLVM_PATH`, else the newest in the system's folders."""
    if os.environ.get(_LLVM):
        named = Path(os.environ[_LLVM])
        return named if named.is_file() else None
    libraries = [file for folder in _FOLDERS for file in Path(folder).glob("**/libLLVM*") if _version(file) is not None]
    return max(libraries, key=lambda file: (_version(file) or 0, str(file)), default=None)


def _version(file: Path) -> int | None:
    match = re.match(r"libLLVM(?:-C)?(?:[-.]so)?[-.](?:so\.)?(\d+)(?:[.\d]*)(?:\.so|\.dylib)?(?:[.\d]*)$", file.name)
    return int(match[1]) if match else None


def check_installed() -> None:
    """Raise `InputError` with the command that helps if Sionna RT is missing, or the LLVM library that it needs."""
    require_extra("sionna", "radio map")
    if find_llvm() is None:
        value = os.environ.get(_LLVM) or "not found"
        hint = f"Install it: `apt-get install libllvm19`, or set {_LLVM} to its file."
        raise InputError.one("radio map", "LLVM", value, "the library libLLVM, with which Sionna RT uses the CPU", hint)


class SionnaTracer:
    """A scene of one city. `trace` may be called for any number of transmitters."""

    def __init__(self, city: City, settings: TraceSettings) -> None:
        """Raises `InputError` as `check_installed`, and `ComponentError` if Sionna cannot start."""
        check_installed()
        os.environ.setdefault(_LLVM, str(find_llvm()))
        try:
            import mitsuba
            import sionna.rt as rt
        except (ImportError, RuntimeError, OSError) as error:
            raise ComponentError(
                "Sionna RT", f"cannot start: {str(error).splitlines()[0]}", describe_install("sionna")
            ) from error
        self._rt, self._mitsuba = rt, mitsuba
        self._settings = settings
        west, south, east, north = city.bounds
        margin = GROUND_MARGIN_M
        self._scene = rt.load_scene()
        self._scene.frequency = settings.frequency_mhz * 1e6
        concrete = rt.ITURadioMaterial("concrete", "concrete", thickness=0.3)
        ground = rt.ITURadioMaterial("soil", "medium_dry_ground", thickness=10.0)
        self._add("buildings", city_mesh(city), concrete)
        self._add("ground", ground_mesh(west - margin, south - margin, east + margin, north + margin), ground)
        for side in ("tx_array", "rx_array"):
            setattr(self._scene, side, rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="V"))
        self._solver = rt.RadioMapSolver()

    def _add(self, name: str, mesh: Mesh, material: Any) -> None:
        vertices, faces = mesh
        made = self._mitsuba.Mesh(name, len(vertices), len(faces))
        parts = self._mitsuba.traverse(made)
        parts["vertex_positions"] = self._mitsuba.Float(vertices.ravel())
        parts["faces"] = self._mitsuba.UInt32(faces.ravel())
        parts.update()
        self._scene.edit(add=self._rt.SceneObject(mi_mesh=made, name=name, radio_material=material))

    @property
    def description(self) -> Mapping[str, Any]:
        """Program, version and settings, for the provenance of a table."""
        return describe_tracer(self._settings)

    def trace(self, place_enu_m: NDArray[np.float64], grid: LossGrid) -> NDArray[np.float32]:
        """(heights, rows, columns) losses in dB from a place to the points of a grid; NaN where no path is found.

        Points inside buildings have a value here that means nothing.
        """
        if self._scene.get("transmitter") is not None:
            self._scene.remove("transmitter")
        x, y, z = (float(value) for value in place_enu_m)
        self._scene.add(self._rt.Transmitter("transmitter", position=[x, y, z]))
        losses = np.empty(grid.shape, dtype=np.float32)
        frequency = self._settings.frequency_mhz
        for level, height in enumerate(grid.heights_m):
            height_grid, traced = (
                grid._replace(heights_m=(height,)),
                grid._replace(heights_m=(_plane_height(z, height),)),
            )
            free, traced_free = (
                free_space_of(place_enu_m, each_grid, frequency)[0] for each_grid in (height_grid, traced)
            )
            gain = np.where(self._visible(place_enu_m, height_grid), 1.0, 0.0)
            unit = 10.0 ** (0.1 * traced_free)
            sampled = self._expected_rays(place_enu_m, traced) >= MIN_RAYS
            gain += np.where(sampled, self._mean_gain(traced, diffraction=False) * unit, 0.0)
            if self._settings.diffraction:
                # never stronger than the direct path (J(ν) of ITU-R P.526-15 4.1 is not negative), but a sample may be
                gain += np.minimum(self._mean_gain(traced, diffraction=True) * unit, 1.0)
            with np.errstate(divide="ignore"):
                losses[level] = free - 10.0 * np.log10(gain)
        losses[~(losses <= MAX_LOSS_DB)] = np.nan
        return losses

    def _visible(self, place_enu_m: NDArray[np.float64], grid: LossGrid) -> NDArray[np.bool_]:
        """(rows, columns): whether no building stands between a place and the points at the grid's first height."""
        mitsuba = self._mitsuba
        ways = grid.points_enu_m[0].reshape(-1, 3) - place_enu_m
        length = np.maximum(np.linalg.norm(ways, axis=1), 1e-6)
        ray = mitsuba.Ray3f(
            o=mitsuba.Point3f(*(float(value) for value in place_enu_m)),
            d=mitsuba.Vector3f(*np.ascontiguousarray((ways / length[:, None]).T, dtype=np.float32)),
            maxt=mitsuba.Float((length * 0.999).astype(np.float32)),
            time=0.0,
            wavelengths=mitsuba.Color0f(),
        )
        blocked = np.array(self._scene.mi_scene.ray_test(ray)).astype(bool)
        return ~blocked.reshape(grid.rows, grid.columns)

    def _expected_rays(self, place_enu_m: NDArray[np.float64], grid: LossGrid) -> NDArray[np.float64]:
        """(rows, columns): how many of the rays from a place would cross each square in free space."""
        ways = grid.points_enu_m[0] - place_enu_m
        distance = np.linalg.norm(ways, axis=-1)
        solid_angle = grid.spacing_m**2 * np.abs(ways[..., 2]) / np.maximum(distance, grid.spacing_m) ** 3
        return np.asarray(self._settings.samples * solid_angle / (4.0 * np.pi))

    def _mean_gain(self, grid: LossGrid, *, diffraction: bool) -> NDArray[np.float64]:
        """(rows, columns) gains by diffraction, or by reflection, at the grid's first height."""
        width, depth = grid.columns * grid.spacing_m, grid.rows * grid.spacing_m
        middle_east = grid.west_m + 0.5 * (grid.columns - 1) * grid.spacing_m
        middle_north = grid.south_m + 0.5 * (grid.rows - 1) * grid.spacing_m
        coverage = self._solver(
            self._scene,
            center=[middle_east, middle_north, grid.heights_m[0]],
            orientation=[0.0, 0.0, 0.0],
            size=[width, depth],
            cell_size=[grid.spacing_m, grid.spacing_m],
            max_depth=1 if diffraction else self._settings.depth,
            los=False,
            specular_reflection=not diffraction,
            refraction=False,
            diffraction=diffraction,
            samples_per_tx=self._settings.samples,
            seed=SEED,
        )
        gain = coverage.path_gain.numpy()[0].astype(np.float64)
        if gain.shape != (grid.rows, grid.columns):
            raise ComponentError("Sionna RT", f"a map of {gain.shape} squares for {grid.rows} x {grid.columns}")
        return np.asarray(gain)


def _plane_height(transmitter_m: float, height_m: float) -> float:
    """The height at which rays are counted for points at `height_m`: at least `MIN_RISE_M` from the transmitter's."""
    if abs(height_m - transmitter_m) >= MIN_RISE_M:
        return height_m
    up = height_m >= transmitter_m or transmitter_m < 2.0 * MIN_RISE_M
    return transmitter_m + (MIN_RISE_M if up else -MIN_RISE_M)


def describe_tracer(settings: TraceSettings) -> Mapping[str, Any]:
    """Program, version and settings, as provenance of a table."""
    from importlib.metadata import version

    return {
        "name": "sionna-rt",
        "version": version("sionna-rt"),
        "mitsuba": version("mitsuba"),
        "solver": "RadioMapSolver",
        "reflections": settings.depth,
        "diffraction": settings.diffraction,
        "refraction": False,
        "samples": settings.samples,
        "seed": SEED,
        "buildings": "concrete",
        "ground": "medium_dry_ground",
        "max_loss_db": MAX_LOSS_DB,
        "min_rise_m": MIN_RISE_M,
        "min_rays": MIN_RAYS,
    }
