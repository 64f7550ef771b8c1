"""Remote ID: the broadcasts of aircraft, and the tracks that receivers derive from them."""
