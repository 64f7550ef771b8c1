"""Execution of plans of runs: blocks on processes of this machine or on a cluster, stored as they end, and resumed."""
