"""Attacks on any link: loss, delay, order, copies, damage, load, and eavesdropping."""
