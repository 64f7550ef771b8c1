"""Attacks on signed MAVLink: frames with a stolen or guessed key, and signed frames of the past."""
