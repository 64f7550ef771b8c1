"""Reactions of two kinds of autopilot to attacks: flights, rules, tables."""
