"""The contracts: what an agent, a tap, an engine, a world and an observer are, and what passes between them."""
