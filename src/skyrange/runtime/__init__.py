"""Drive a wired range: as fast as it goes, or paced to the wall clock; stop it cleanly whatever happens."""
