"""Can the layout decide what looks could not? (paper III-E; method.md#layout)."""
