"""What is remembered of every object: prototypes and lifecycle (method.md#memory)."""
