"""What does each detection look like: pooling, parts, rings.

Rules: method.md#perception (paper III-B).
"""
