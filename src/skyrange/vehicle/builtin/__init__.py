"""The builtin autopilot: ArduCopter's behaviour for a fleet, arrays at loop rate and objects at message rate.

Where it knowingly differs from ArduCopter 4.6:

- Its estimator is a smaller EKF3 (`estimation`): one lane, three covariances, no drag fusion, no wind or terrain
  states.
- Modes are STABILIZE, ALT_HOLD, AUTO (with AUTO_RTL), GUIDED, LOITER, RTL, LAND and BRAKE; others do not exist.
- Sticks are moved by MAVLink alone. Where nothing moves the throttle, ALT_HOLD and LOITER hold the height as in
  ArduCopter's failsafe of the radio, which does not exist here: it would also return or land.
- Failsafes are looked at every 100 ms; there is no SmartRTL, no thrust boost, no vibration, terrain or CPU
  failsafe.
- Terrain is flat, at the height of the origin.
- Mission items that are flown otherwise are refused: guided within a mission, payload, attitude for a time,
  scripts, the VTOL names of take-off and landing, jumps to tags, DO_RETURN_PATH_START. An item waits to be started
  until the motors are armed.
- A waypoint that is reached again is so once a second at most, not at every turn of the loop; a jump back among DO
  items that go with a navigation item ends them, where ArduCopter would do them until the next navigation item.
- A pause in AUTO brakes as one in GUIDED does and goes on along a new leg from where it came to rest; ArduCopter's
  slows down along the leg, which is another way in curves and corners only.
- There is no motor test: UNSUPPORTED on the ground. Calibration, cameras and gimbals have no commands.
- Messages are sent on the 10 ms grid, each at most once there, whatever its interval.
- A parameter out of its range is stored as it comes and acts as the nearest value inside; SYSID_THISMAV acts at
  boot.
- A field that is no number, where ArduPilot makes an integer of it, is refused.
- On touchdown it softens its hold on the place, so that it also disarms in a wind that it has to lean into.
- Yaw gains of the airframes are tuned (`parameters.TUNING`); BATT_MONITOR is 4, as in SITL.
"""
