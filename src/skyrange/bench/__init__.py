"""Benchmarks: the speed of the range on this machine, and where the time goes."""
