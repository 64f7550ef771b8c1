"""Bases of defences by where they are: taps at ends of links, checks of fixes, policies of Wi-Fi channels."""
