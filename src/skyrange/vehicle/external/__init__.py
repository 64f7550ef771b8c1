"""Which vehicles fly outside? Real ones, or simulations that the range did not start, seen by what they report."""
