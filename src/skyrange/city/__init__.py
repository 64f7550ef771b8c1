"""What stands in the way: building footprints with heights, and questions about them."""
