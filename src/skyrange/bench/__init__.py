"""Measure: how fast does the range run here, and where does the time go?"""
