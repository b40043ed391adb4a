"""Configuration: static structure, traced thresholds, YAML files, the original's keys."""

from remind_jax.config.config import Config as Config
from remind_jax.config.config import load_config as load_config
from remind_jax.config.files import describe_config as describe_config
from remind_jax.config.files import list_configs as list_configs
