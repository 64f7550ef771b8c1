"""DRIP (RFC 9374, RFC 9575): keys and a registry, the sender's messages and their rates, and a receiver that verifies.

All of it is a model of the defence: keys follow from the seed and protect nothing real.
"""
