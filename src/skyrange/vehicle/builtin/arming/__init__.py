"""Arming: arming and disarming, pre-arm checks, and the check of the Remote ID transmitter."""
