"""What does each detection look like: pooling, parts, rings (paper III-B)."""
