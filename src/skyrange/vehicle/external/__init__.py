"""External vehicles: real ones, or simulations that the range did not start, observed through their reports."""
