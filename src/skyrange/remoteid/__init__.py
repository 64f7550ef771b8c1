"""What does an aircraft tell everybody near it? Remote ID broadcasts, and the tracks that receivers make of them."""
