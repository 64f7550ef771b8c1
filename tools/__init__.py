"""Programs of the development of skyrange: which lines each test executes, and which faults the tests find."""
