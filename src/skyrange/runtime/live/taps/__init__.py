"""External taps: programs of the user's that stand on a link of a live range."""
