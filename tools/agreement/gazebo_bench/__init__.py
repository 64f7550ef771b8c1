"""Benchmarks of ArduPilots in Gazebo: the speed of fleets, a collision, and the page of their results."""
