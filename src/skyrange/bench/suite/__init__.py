"""All benchmarks in one command: their cases, the load of the machine meanwhile, results as JSON, and pages of them."""
