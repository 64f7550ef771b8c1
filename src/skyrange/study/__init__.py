"""Studies of runs: running and pairing scenarios, measures, comparisons, figures, reports and exports."""
