"""What is remembered of every object: prototype banks and lifecycle (paper III-C, III-F)."""
