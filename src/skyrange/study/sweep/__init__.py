"""Studies: many runs of one scenario, by factors, arms and seeds, with one table of what they measured."""
