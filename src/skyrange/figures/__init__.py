"""Figures of a run as SVG: trajectories in space, plan view, altitude and track deviation over time.

Each function takes a run's record and returns a `Figure`, which a notebook shows and `save` writes. Figures contain no
script and fetch nothing. Elements of aircraft number k of the manifest have the class `ink-k`, so a page can recolour
them.
"""

from skyrange.figures.run import (
    altitude,
    overview,
    plan_view,
    track_deviation,
    trajectories_3d,
)
from skyrange.figures.svg import Figure

__all__ = ["Figure", "altitude", "overview", "plan_view", "track_deviation", "trajectories_3d"]
