"""Can the layout decide what looks could not? (paper III-E; context notes 11)."""
