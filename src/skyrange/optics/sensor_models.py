"""Models of LiDARs and of a depth camera, from data sheets. What no data sheet says is called assumed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from skyrange.optics.scan_patterns import PixelGrid, RotatingPattern, ScanPattern, ScatteredPattern, SingleBeam


@dataclass(frozen=True, slots=True)
class LidarModel:
    """A pulsed time-of-flight LiDAR that returns the strongest echo of each pulse."""

    name: str
    pattern: ScanPattern
    wavelength_um: float
    divergence_rad: tuple[float, float]
    """Full angles across and up. The beam is taken as a rectangle of even power."""
    aperture_m: tuple[float, float]
    """Size of the beam where it leaves the sensor, across and up."""
    near_m: float
    """What is nearer blocks the beam and is not returned."""
    reach_m: float
    """What is farther is not returned."""
    reference_m: float
    """The distance up to which a surface of `reference_reflectivity` that fills the beam is returned, in clear air and
    at right angles, with `reference_probability`."""
    reference_reflectivity: float
    reference_probability: float
    false_alarm: float
    """Probability that a pulse returns a distance where nothing is: noise that crosses the threshold."""
    drop_out: float
    """Probability that a pulse is lost whatever it meets."""
    noise_m: float
    """Standard deviation of the distance to a near surface."""
    rise_m: float
    """Half of the way of light during the rise of the pulse: this, divided by the ratio of signal to noise, is the
    standard deviation that grows with distance."""
    resolution_m: float
    """Step of the distances that it reports, as whole numbers of 16 bits."""


VLP_16: Final = LidarModel(
    # Velodyne VLP-16 User Manual, 63-9243 Rev. D: 16 channels from -15 to 15 degrees in steps of 2, fired in the order
    # of table 9-1, every 2.304 us; a sequence takes 55.296 us; 5 to 20 turns a second; 903 nm; up to 100 m; accuracy
    # +-3 cm (typical), here one standard deviation; distances in steps of 2 mm; nothing below about 1 m.
    name="VLP-16",
    pattern=RotatingPattern(
        elevation_deg=(-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15),
        sequence_s=55.296e-6,
        firing_s=2.304e-6,
        rate_hz=10.0,
    ),
    wavelength_um=0.903,
    # Velodyne VLS-128 User Manual, table F-1, of the same maker's lasers: 3.0 mrad across, 1.5 mrad up.
    divergence_rad=(3.0e-3, 1.5e-3),
    # Assumed: about a centimetre.
    aperture_m=(12.7e-3, 9.5e-3),
    near_m=1.0,
    reach_m=100.0,
    # Assumed: the 100 m are those of a reflectivity of 0.8, returned nine times in ten.
    reference_m=100.0,
    reference_reflectivity=0.8,
    reference_probability=0.9,
    # Assumed, as for the Mid-360.
    false_alarm=1e-4,
    drop_out=0.0,
    noise_m=0.03,
    # Assumed: half of a pulse of 6 ns.
    rise_m=0.45,
    resolution_m=0.002,
)
"""Rotating: 16 beams, 28,928 pulses a turn, ten turns a second."""

MID_360: Final = LidarModel(
    # Livox Mid-360 User Manual v1.0, specifications: 905 nm; 40 m at a reflectivity of 10 %, 70 m at 80 % (under 100
    # klx); nothing below 0.1 m; 360 degrees by -7 to 52; 200,000 points/s, 10 frames/s; 2 cm (one standard deviation,
    # at 10 m); false alarms below 0.01 %.
    name="Mid-360",
    pattern=ScatteredPattern(rays=20_000, azimuth_deg=(-180.0, 180.0), elevation_deg=(-7.0, 52.0), rate_hz=10.0),
    wavelength_um=0.905,
    # Livox HAP User Manual, table 1.2.1, of the same maker: 0.03 degrees across, 0.28 degrees up.
    divergence_rad=(0.52e-3, 4.9e-3),
    # Assumed.
    aperture_m=(5e-3, 5e-3),
    near_m=0.1,
    reach_m=70.0,
    reference_m=40.0,
    reference_reflectivity=0.1,
    # Assumed: the manual does not say how often what is in range is returned.
    reference_probability=0.9,
    false_alarm=1e-4,
    drop_out=0.0,
    noise_m=0.02,
    # Assumed, as for the VLP-16.
    rise_m=0.45,
    resolution_m=0.002,
)
"""Solid state, in the sense of its maker: 20,000 pulses a frame over 360 by 59 degrees, never twice alike."""

HAP: Final = LidarModel(
    # Livox HAP User Manual (2022), table 1.2.1: 905 nm; 150 m at a reflectivity of 10 %; nothing below 0.5 m; 120 by 25
    # degrees; 2 cm (one standard deviation, at 20 m); divergence 0.03 by 0.28 degrees; 452,000 points/s, 10 frames/s;
    # false alarms 0.01 %.
    name="HAP",
    pattern=ScatteredPattern(rays=45_200, azimuth_deg=(-60.0, 60.0), elevation_deg=(-12.5, 12.5), rate_hz=10.0),
    wavelength_um=0.905,
    divergence_rad=(0.52e-3, 4.9e-3),
    # Assumed, as for the Mid-360.
    aperture_m=(5e-3, 5e-3),
    near_m=0.5,
    # Assumed: the manual has no greatest distance.
    reach_m=250.0,
    reference_m=150.0,
    reference_reflectivity=0.1,
    reference_probability=0.9,
    false_alarm=1e-4,
    drop_out=0.0,
    noise_m=0.02,
    rise_m=0.45,
    # Assumed: what 16 bits hold.
    resolution_m=0.005,
)
"""Solid state, forward: 45,200 pulses a frame over 120 by 25 degrees. Made for cars, and too heavy for an Iris."""

LIDAR_LITE_V3HP: Final = LidarModel(
    # Garmin LIDAR-Lite v3HP Operation Manual, specifications: 905 nm; 5 cm to 40 m on a target of 70 %; divergence 8
    # mrad; aperture 12.5 mm; resolution 1 cm; accuracy +-2.5 cm from 2 m on, here one standard deviation.
    name="LIDAR-Lite v3HP",
    pattern=SingleBeam(direction=(1.0, 0.0, 0.0), rate_hz=100.0),
    wavelength_um=0.905,
    divergence_rad=(8e-3, 8e-3),
    aperture_m=(12.5e-3, 12.5e-3),
    near_m=0.05,
    reach_m=40.0,
    reference_m=40.0,
    reference_reflectivity=0.7,
    # Assumed, as for the others.
    reference_probability=0.9,
    false_alarm=1e-4,
    drop_out=0.0,
    noise_m=0.025,
    rise_m=0.45,
    resolution_m=0.01,
)
"""A single beam, forward, a hundred times a second."""


@dataclass(frozen=True, slots=True)
class DepthCameraModel:
    """A stereo camera that gives the depth along its axis for each pixel."""

    name: str
    pattern: PixelGrid
    near_m: float
    reach_m: float
    baseline_m: float
    subpixel: float
    """Standard deviation of the disparity in pixels."""
    resolution_m: float

    def noise_m(self, depth_m: float) -> float:
        """Standard deviation of a depth: depth² · subpixel / (focal length · baseline).

        Intel, "Best-Known-Methods for Tuning Intel RealSense D400 Depth Cameras for Best Performance", depth error.
        """
        return depth_m * depth_m * self.subpixel / (self.pattern.focal_px[0] * self.baseline_m)


D435: Final = DepthCameraModel(
    # Intel RealSense D400 Series Product Family Datasheet, D435: depth field of view at 4:3 75 by 62 degrees; baseline
    # 50 mm; range 0.11 to 10 m; depth in steps of 1 mm. 320 x 240 are every second pixel of its 640 x 480.
    name="D435 at 320 x 240",
    pattern=PixelGrid(width=320, height=240, field_deg=(75.0, 62.0), rate_hz=10.0),
    near_m=0.11,
    reach_m=10.0,
    baseline_m=0.05,
    # Assumed within what the same paper of Intel's calls typical of a textured surface: below 0.1.
    subpixel=0.08,
    resolution_m=0.001,
)
"""A depth camera of 320 x 240 pixels."""
