"""The builtin autopilot: ArduCopter's behaviour for a fleet, arrays at loop rate and objects at message rate."""
