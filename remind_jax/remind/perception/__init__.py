"""What each detection looks like: pooling, parts, rings (method.md#perception)."""
