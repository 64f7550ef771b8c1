"""What every part shares: time, ids, geodesy, volumes, addressed chance, errors."""
