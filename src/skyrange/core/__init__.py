"""What every package shares: time, ids, geodesy, volumes, addressed chance, compilation, errors."""
