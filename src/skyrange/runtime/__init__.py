"""Runs of a scenario: as fast as possible, paced to the wall clock, or live, as processes on sockets."""
