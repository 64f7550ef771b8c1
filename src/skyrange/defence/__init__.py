"""Kinds of defences: what stands in the way of attacks, at the ends of links and between sensors and autopilot."""
