"""Failsafes: one module for each.

`checks` calls them. Each has a compiled function that checks one aircraft's records and returns `Alarm`s, and functions
of one aircraft that act on them in ArduCopter's order and words. Parameters, actions, texts and severities are those of
ArduCopter 4.6.
"""
