"""The arducopter program: finding it, examining it, and listing its parameters."""
