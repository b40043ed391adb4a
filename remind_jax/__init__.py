"""Online long-term re-identification of object instances, in JAX."""
