"""What does an aircraft do about another one that it hears? Kinds of avoidance, all by one contract."""
