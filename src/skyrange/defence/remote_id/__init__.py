"""Defences of receivers of Remote ID: broadcasts that cannot be true do not reach avoidance."""
