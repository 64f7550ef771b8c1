"""The builtin autopilot: ArduCopter's behaviour for a fleet, arrays at loop rate and objects at message rate.

Where it knowingly differs from ArduCopter 4.6:

- Its estimator is a smaller EKF3 (`estimation`): one lane, three covariances, no drag fusion, no wind or terrain
  states.
- Modes are STABILIZE, ALT_HOLD, AUTO, GUIDED, LOITER, RTL, LAND and BRAKE; others do not exist. There is a radio
  receiver whose sticks only MAVLink moves, and no failsafe of the radio.
- Failsafes are looked at every 100 ms; there is no SmartRTL, no thrust boost, no vibration, terrain or CPU
  failsafe; DO_LAND_START actions return, and DO_LAND_START is no command.
- Terrain is flat, at the height of the origin.
- Mission items that are flown otherwise are refused: guided within a mission, payload, attitude for a time,
  scripts, the VTOL names of take-off and landing, jumps to tags. An item waits to be started until the motors are
  armed.
- A waypoint that is reached again is so once a second at most, not at every turn of the loop; a jump back among DO
  items that go with a navigation item ends them, where ArduCopter would do them until the next navigation item.
- A motor test and a pause are refused. Calibration, cameras and gimbals have no commands.
- Messages are sent on the 10 ms grid, each at most once there, whatever its interval.
- A parameter out of its range is stored as it comes and acts as the nearest value inside; SYSID_THISMAV acts at
  boot.
- A field that is no number, where ArduPilot makes an integer of it, is refused.
- On touchdown it softens its hold on the place, so that it also disarms in a wind that it has to lean into.
- Yaw gains of the airframes are tuned (`parameters.TUNING`); BATT_MONITOR is 4, as in SITL.
"""
