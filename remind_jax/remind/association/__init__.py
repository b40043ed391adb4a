"""Who is who: similarity, gates, locks, assignment (method.md#comparison, method.md#assignment)."""
