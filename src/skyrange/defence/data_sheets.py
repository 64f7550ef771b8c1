"""What checks of GNSS fixes assume of sensors: values of data sheets and of the autopilot, not those of the world.

The world has errors of its own (`[sensors]` of a scenario), which may be others: then a check is mismatched. Nothing
here is imported from the world's models, and nothing that the world draws depends on it.

[S] is ArduPilot's simulator (libraries/SITL), [U] the data sheet of the u-blox SAM-M10Q (UBX-22013293).
"""

from __future__ import annotations

import math
from typing import Final

IMU_S: Final = 0.01
"""Interval of the samples whose noise is stated, 100 Hz."""
GYRO_REST_RADPS: Final = math.radians(0.04)
"""Noise of a gyroscope at rest: quantisation floor of AP_InertialSensor_SITL.cpp."""
GYRO_FLIGHT_RADPS: Final = GYRO_REST_RADPS + math.radians(0.1)
"""The same at full throttle: [S] SIM_Aircraft.cpp, `add_noise`, adds 0.1 deg/s."""
ACCEL_FLIGHT_MPS2: Final = 0.01 + 0.3
"""Noise of an accelerometer at full throttle: the floor, and 0.3 m/s² of the same function."""
ACCEL_BIAS_MPS2: Final = 0.05
"""What calibration leaves of an accelerometer's bias: 5 mg of the 20 mg of an ICM-42688-P."""

FIX_3D: Final = 3
"""A fix in three dimensions, as in GPS_RAW_INT."""
FIX_S: Final = 0.2
"""Interval of fixes: GPS_RATE_MS 200."""
WANDER_M: Final = 1.5 / 1.1774
"""Slow error of a fix along a level axis: [U] 1.5 m circular error probable, 1.1774 standard deviations of an axis."""
WANDER_UP_M: Final = 1.5 * WANDER_M
"""In height: 1.5 times that, as EKF3 assumes (AP_NavEKF3_Measurements.cpp)."""
WANDER_S: Final = 60.0
"""Correlation time of that error: gps_correlation_time of PX4's Gazebo plugin."""
WHITE_M: Final = 0.05
"""Error of a fix that the next one does not share: [U] the velocity accuracy over an interval of fixes."""
SPEED_MPS: Final = 0.05
"""Error of the velocity along an axis: [U] 50 % at 30 m/s."""
CLAIMED: Final = (1.5, 2.5, 0.2)
"""Accuracies that a receiver claims under an open sky: level m, height m, speed m/s; typical of u-blox receivers."""
LOST_S: Final = 3.0
"""Longest usual loss of a fix. *Assumed*: no data sheet gives it."""

BARO_NOISE_M: Final = 0.2 / math.sqrt(3.0)
"""Noise of a reading: [S] SIM_BARO_RND 0.2, the half-width of a uniform."""
WEATHER_M: Final = 1.0
WEATHER_S: Final = 1800.0
"""Drift of pressure by weather and its correlation time. *Assumed*: a few metres an hour."""
