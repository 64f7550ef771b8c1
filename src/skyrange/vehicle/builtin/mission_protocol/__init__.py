"""Mission protocol: upload and download of missions, fences and rally points."""
