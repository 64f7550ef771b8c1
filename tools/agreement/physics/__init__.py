"""Flights in the range's own physics and in Gazebo's: what differs, and by how much."""
