"""Formats of the files that stand for parameters and missions in ArduPilot's file system."""
