"""Rows of tables: frames, payloads, receptions, truth and sensors, encoded into Arrow batches and hash words."""
