"""Which objects belong together here? (paper III-D)."""
