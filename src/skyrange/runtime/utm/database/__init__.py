"""Database of a UTM service: its tables, their migrations, and the journals that write to them."""
