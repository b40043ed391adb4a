"""What is remembered of every object: prototype banks and lifecycle.

Rules: method.md#memory (paper III-C, III-F).
"""
