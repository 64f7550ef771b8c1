"""Scores of detectors over the runs of a study: what was detected, how soon, and how many false alarms it cost."""
