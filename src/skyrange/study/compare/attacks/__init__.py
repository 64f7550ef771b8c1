"""Reactions of two kinds of autopilot to attacks by MAVLink: flights, rules, tables."""
