"""Execution of a study: its blocks on processes of this machine or on a cluster."""
