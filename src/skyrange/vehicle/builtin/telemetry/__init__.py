"""What does the aircraft report, and how often?"""
