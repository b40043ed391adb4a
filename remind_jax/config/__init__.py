"""Configuration: static structure, traced thresholds, YAML files, the original's keys."""
