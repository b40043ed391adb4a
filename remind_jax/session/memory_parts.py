"""A memory file in parts: first everything, then what changed each time, each with its checksum.

A part is what safetensors call a file, and is added at once: after a kill or a power cut the last
one may not be whole, and then it does not count.
"""

from __future__ import annotations

import itertools
import logging
from pathlib import Path

from remind_jax.errors import OutputError
from remind_jax.files.tensors import SafetensorsPart, checksum_of, read_safetensors_parts
from remind_jax.session.earlier_memory import EARLIER_VERSIONS

SCHEMA_VERSION = 9
FORMAT = "remind-jax memory"
FORMAT_OF_CHANGES = "remind-jax memory, what changed"
RESTORE = "restore the file, or start without it"

_log = logging.getLogger("remind_jax")


def read_parts(path: Path) -> list[SafetensorsPart]:
    """Everything, then what changed each time; a last change that is not whole is left out.

    Raises:
      OutputError: If it cannot be read, is no memory file of a schema that is read, or is damaged.
    """
    parts, is_whole = read_safetensors_parts(path, refused=OutputError)
    first = parts[0].metadata
    if first.get("format") != FORMAT:
        raise OutputError(f"'{path}' is not a memory file of remind-jax")
    schema = first.get("schema")
    if schema not in (*EARLIER_VERSIONS, str(SCHEMA_VERSION)):
        raise OutputError(
            f"'{path}' has memory schema {schema!r}; this version reads schemas "
            f"{', '.join(EARLIER_VERSIONS)} and {SCHEMA_VERSION}"
        )
    # Blocks that were not on the disk yet when the power went are found by the checksum alone.
    if is_whole and len(parts) > 1 and not _is_sound(parts[-1]):
        parts, is_whole = parts[:-1], False
    checksum = first.get("sha256")
    if checksum is not None and not _is_sound(parts[0]):
        raise OutputError(f"'{path}' is damaged: its checksum is another one; {RESTORE}")
    for before, part in itertools.pairwise(parts):
        own = part.metadata
        follows = own.get("after") == before.metadata.get("sha256")
        if not follows or own.get("format") != FORMAT_OF_CHANGES or not _is_sound(part):
            raise OutputError(
                f"'{path}' is damaged: a change in it is another one, or does not follow the one "
                f"before; {RESTORE}"
            )
    if not is_whole:
        _log.warning("the last change of '%s' was not written to its end and is left out", path)
    return parts


def _is_sound(part: SafetensorsPart) -> bool:
    return part.metadata.get("sha256") == checksum_of(part.metadata, part.tensors)
