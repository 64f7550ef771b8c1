"""What goes wrong in flight, and what does the aircraft do about it? One module per failsafe.

`service` calls them. Each has a kernel that checks one aircraft's records and returns `Alarm`s, and functions of one
craft that act on them in ArduCopter's order and words. Parameters, actions, texts and severities are those of
ArduCopter 4.6.
"""
