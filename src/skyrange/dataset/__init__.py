"""Labelled data sets of runs: views, labels, splits, an audit for leaks, and files that other tools open."""
