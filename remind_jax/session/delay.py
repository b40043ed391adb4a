"""How long answers wait, to be revised by what turns out meanwhile."""

from __future__ import annotations

from remind_jax.errors import ConfigError
from remind_jax.method import Method
from remind_jax.settings.ranges import check_option

# Frames that answers about a recording wait; longer changes next to nothing (`docs/plus.md`).
RECORDED_DELAY = 20

_MAX_DELAY = 1_000_000  # frames


def choose_delay(asked: int | None, method: Method, *, is_live: bool = False) -> int:
    """Frames that answers wait: those that were asked for, else what the method gains from.

    Raises:
      ConfigError: If the number is out of range, or the method never revises an answer.
    """
    can_wait = method.host.delayed is not None
    if asked is None:
        return RECORDED_DELAY if can_wait and not is_live else 0
    check_option("delay", asked, 0, _MAX_DELAY)
    if asked and not can_wait:
        raise ConfigError(
            f"tracker '{method.name}' never revises an answer; leave out delay, or use "
            "tracker 'plus'"
        )
    return asked
