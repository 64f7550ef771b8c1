"""Statistical inference: means, proportions, rates, tests, and what counts as independent."""
