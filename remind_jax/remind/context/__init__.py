"""Which objects belong together here? (paper III-D; method.md#context)."""
