"""Gazebo: vehicles whose bodies a Gazebo simulates, in a process of its own."""
