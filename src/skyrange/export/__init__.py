"""Export of runs for other tools: MCAP for Foxglove and Lichtblick, KML for globes, and CSV tables."""
