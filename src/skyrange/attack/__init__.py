"""What does an adversary do? Attacks as declared things: kinds, parameters, schedules and triggers."""
