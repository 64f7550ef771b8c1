"""Flight approval by a federation after ASTM F3548-21: USSs that know their own intents, and a DSS by which they find
those of others.
"""
