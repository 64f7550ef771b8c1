"""The viewer's stream (docs/reference/viewer-stream.md): encoder of recorded runs, and decoder."""
