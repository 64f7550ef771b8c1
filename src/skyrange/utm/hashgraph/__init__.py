"""Hashgraph consensus: signed events, their graph, and the order that every honest member computes from it."""
