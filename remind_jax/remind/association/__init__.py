"""Who is who: similarity, gating, locks and the joint assignment (paper III-E).

Rules: method.md#comparison, method.md#assignment.
"""
