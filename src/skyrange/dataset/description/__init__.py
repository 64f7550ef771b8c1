"""Description of a data set: metadata, datasheet, checksums, and how to fly its runs again."""
