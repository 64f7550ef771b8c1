"""Routes between places over a city: a search on a lattice, and shortcuts."""
