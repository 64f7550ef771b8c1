"""Coordinate systems of building files: reprojection to WGS 84 degrees by pyproj."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.core.errors import InputError

WGS84 = "WGS 84 degrees"

_EPSG = re.compile(r"EPSG(?:/\d+/|:[\d.]*:|:)(\d{4,6})", re.IGNORECASE)
_DEGREES = re.compile(r"CRS:?84|OGC:1\.3:CRS84|EPSG:{1,2}(?:4326|4979)$|^$", re.IGNORECASE)

INSTALL_HINT = "Install it with `pip install 'skyrange[city]'`."


class Projection:
    """Reprojects coordinates of one system to longitude and latitude in degrees of WGS 84."""

    def __init__(self, name: str, crs: str, authority_order: bool = False) -> None:
        """`name` is the file, `crs` anything that pyproj knows: EPSG code, URN, URL or WKT.

        With `authority_order`, coordinates of a geographic system are latitude, longitude, as CityGML writes them;
        otherwise x is east. Raises `InputError` for an unknown system and without pyproj.
        """
        self._name = name
        self.label = WGS84
        self._transformer: Any = None
        self._swapped = False
        if _DEGREES.search(crs) and not authority_order:
            return
        try:
            from pyproj import CRS, Transformer
            from pyproj.exceptions import CRSError
        except ImportError as error:
            expected = "pyproj, which reprojects it to degrees"
            raise InputError.one(name, "coordinate system", f"{crs:.60}", expected, INSTALL_HINT) from error
        found = _EPSG.search(crs)
        try:
            system = CRS.from_user_input(f"EPSG:{found[1]}" if found and "[" not in crs else crs)
            system = next((part for part in system.sub_crs_list if not part.is_vertical), system)
            self._transformer = Transformer.from_crs(system, "EPSG:4326", always_xy=True)
        except CRSError as error:
            hint = f"ogr2ogr -f GeoJSON -s_srs EPSG:… -t_srs EPSG:4326 city.geojson {name}"
            expected = "a coordinate system that PROJ knows"
            raise InputError.one(name, "coordinate system", f"{crs:.60}", expected, f"Convert it: `{hint}`.") from error
        self._swapped = authority_order and system.is_geographic
        authority = system.to_authority()
        self.label = f"{':'.join(authority)} {system.name}" if authority else system.name

    @property
    def is_degrees(self) -> bool:
        """Whether coordinates are longitude and latitude of WGS 84 already."""
        return self._transformer is None

    def to_degrees(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 2) longitude and latitude of (n, 2) coordinates; infinite where there is no such place."""
        if self._transformer is None:
            return xy
        x, y = (xy[:, 1], xy[:, 0]) if self._swapped else (xy[:, 0], xy[:, 1])
        return np.column_stack(self._transformer.transform(x, y))
