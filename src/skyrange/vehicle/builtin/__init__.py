"""Builtin autopilot: ArduCopter's behaviour for a whole fleet, in compiled loops over arrays and objects per message.

Known differences from ArduCopter 4.6:

- The estimator is a reduced EKF3 (`estimation`): one core (lane), three covariances, no drag fusion, no wind or terrain
  states.
- The modes are STABILIZE, ALT_HOLD, AUTO (with AUTO_RTL), GUIDED, LOITER, RTL, LAND and BRAKE. No others exist.
- The sticks are moved by MAVLink alone. Where nothing moves the throttle, ALT_HOLD and LOITER hold the height, as
  ArduCopter does in its radio failsafe. That failsafe does not exist here; it would also return or land.
- Failsafes are checked every 100 ms. There is no SmartRTL, no thrust boost, and no vibration, terrain or CPU failsafe.
- The terrain is flat, at the height of the origin.
- Mission items that this autopilot would fly differently are refused: payload placement, DO_RETURN_PATH_START,
  DO_SET_RESUME_REPEAT_DIST, enabling a parachute, and auxiliary functions other than those of modes, fence, disarming
  and devices that are not fitted. No item starts before the motors are armed.
- A waypoint counts as reached again after 10 ms at the earliest, not in every pass of the loop. A jump back among the
  DO commands of one navigation command ends them; ArduCopter would run them until the next navigation command.
- A pause in AUTO brakes like a pause in GUIDED and continues along a new leg from where the aircraft came to rest.
  ArduCopter slows down along the leg, which is a different path in curves and corners only.
- There is no motor test: on the ground it is UNSUPPORTED. Calibration, cameras and gimbals have no commands.
- Messages are sent on the 10 ms grid, each at most once per grid point, whatever its interval.
- A parameter value outside its range is stored as received and takes effect as the nearest value inside the range;
  SYSID_THISMAV takes effect at boot.
- A field that is not a number is refused where ArduPilot would convert it to an integer.
- On touchdown the position hold is softened, so that the aircraft also disarms in a wind that it has to lean into.
- The yaw gains of the airframes are tuned (`parameters.table.AIRFRAME_TUNING`); BATT_MONITOR is 4, as in SITL.
"""
