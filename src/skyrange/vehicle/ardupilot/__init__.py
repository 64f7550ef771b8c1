"""How does an aircraft fly on a real ArduPilot? One `arducopter` process each, behind the contract of the builtin."""
