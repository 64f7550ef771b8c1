"""Kinds of benign faults: what goes wrong without an adversary, as negatives beside attacks."""
