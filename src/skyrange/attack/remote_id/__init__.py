"""Attacks on Remote ID: spoofing, replay and jamming."""
