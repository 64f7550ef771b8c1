"""Statistical inference of studies: means, proportions, rates, tests, and what counts as independent."""
