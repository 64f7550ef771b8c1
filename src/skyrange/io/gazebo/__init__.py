"""Gazebo as a child process."""
