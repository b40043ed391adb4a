"""What was done to a file."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Change:
    """What was done to a file."""

    name: str
    is_invalid: bool  # nothing that reads this may take it for good
