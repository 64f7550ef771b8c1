"""Scores of a study: tables that scoring reads, and learned detectors trained on its blocks."""
