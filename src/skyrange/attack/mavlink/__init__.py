"""Attacks that speak MAVLink to an aircraft: commands, targets, sticks, missions, parameters, hostile frames."""
