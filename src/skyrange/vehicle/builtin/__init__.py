"""The builtin autopilot: ArduCopter's behaviour for a fleet, arrays at loop rate and objects at message rate.

Where it knowingly differs from ArduCopter 4.6:

- It believes ideal sensors (`loop.ideal_estimate`): no estimator, no battery, no radio control, and no failsafes.
- STABILIZE exists only as the mode at boot. Modes are STABILIZE, AUTO, GUIDED, RTL, LAND, BRAKE; others do not exist.
- Legs use a trapezoidal, not a sinusoidal, acceleration profile; a new speed waits for the leg's cruise. Corners are
  rounded by adding the end of one leg to the start of the next, from the acceptance radius on.
- Attitude targets are not shaped and carry no rate feed-forward; the yaw loop of the Iris is tuned tighter.
- Mission items: WAYPOINT, TAKEOFF, LAND, RETURN_TO_LAUNCH, DO_JUMP, DO_CHANGE_SPEED; altitudes above home or sea,
  none above terrain. No fence and no rally points. An item waits to be started until the motors are armed.
- GUIDED takes positions and velocities; no acceleration, yaw or yaw rate.
- Messages are sent on the 10 ms grid, each at most once there, whatever its interval.
- A parameter out of its range is stored as it comes and acts as the nearest value inside; SYSID_THISMAV acts at boot.
- A field that is no number, where ArduPilot makes an integer of it, is refused.
- On touchdown it softens its hold on the place, so that it also disarms in a wind that it has to lean into.
- A mission of jumps over one waypoint that is already there reaches it again at every tick.
"""
