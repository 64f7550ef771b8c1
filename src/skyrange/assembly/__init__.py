"""Assembly: from a scenario to a range that a kernel can run, placed, checked and connected."""
