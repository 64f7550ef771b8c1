"""City model: building footprints with heights, and spatial queries on them."""
