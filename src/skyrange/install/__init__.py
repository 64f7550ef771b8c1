"""How do real engines get onto this machine? Downloaded from where their makers publish them, checked, put away."""
