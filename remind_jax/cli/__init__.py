"""The `remind` command, one module per verb."""
