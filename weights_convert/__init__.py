"""From published weight files to the one layout that `remind_jax.backbone` reads."""
