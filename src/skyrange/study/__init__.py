"""Plans of runs and their execution: runs, pairs, variants, matrices, and studies by factors, arms and seeds."""
