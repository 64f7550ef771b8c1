"""Remote id."""
