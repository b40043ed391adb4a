"""Published weights by name: fetched once, checked, converted and kept (backbones.md#by-name).

What the hub's own cache (HF_HOME) holds already is converted from there and left alone. What is
fetched lies in `weights/NAME/` beside the converted files until it is converted, and not after, so
nothing stays on the disk twice. One process fetches, others wait for it.
"""

from __future__ import annotations

import contextlib
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from remind_jax.backbone.published_weights import PUBLISHED, PublishedWeights
from remind_jax.backbone.vit_variants import TERMS, VARIANTS
from remind_jax.backbone.vit_weights import default_folder, find_weights, look_for_weights
from remind_jax.errors import OutputError, WeightsError, printable
from remind_jax.files import make_folder

_PARTIAL = ".partial"


def obtain_weights(name: str, given: str | Path | None = None, *, quiet: bool = False) -> Path:
    """Where the converted weights of a named network are; fetches those that are nowhere yet.

    Args:
      name: Of the variant.
      given: A file or folder, which must hold them; looked for as `vit_weights.look_for_weights`
        says if left out, and fetched if there are none.
      quiet: Say nothing and show no progress.

    Raises:
      WeightsError: If there are none, and they cannot be fetched or are not the published ones.
      OutputError: If they cannot be kept.
    """
    found, _ = look_for_weights(name, given)
    if found is not None or given is not None or name not in PUBLISHED:
        return found or find_weights(name, given)
    return fetch_weights(name, quiet=quiet)


def fetch_weights(name: str, *, quiet: bool = False) -> Path:
    """Fetches, checks and converts the published weights of a network; raises as above."""
    folder = default_folder()
    out = folder / f"{name}.safetensors"
    make_folder(folder)
    with _alone(folder / f"{name}.lock", name, quiet):
        if not out.is_file():
            _make(name, out, quiet)
    return out


def was_fetched(name: str, path: Path) -> bool:
    """Whether a converted file lies where fetched ones do, and can be had again."""
    return name in PUBLISHED and path == default_folder() / f"{name}.safetensors"


def place_of_original(name: str) -> Path:
    """Where the published file of a network is until it is converted."""
    return default_folder() / name / PUBLISHED[name].file


def _make(name: str, out: Path, quiet: bool) -> None:
    """Makes the converted file; the rule for position tables is that of the authors' code."""
    from weights_convert.conversion import convert
    from weights_convert.variant_detection import Wishes

    published, rule = PUBLISHED[name], VARIANTS[name].position
    original = _bring(name, published, quiet)
    wishes = Wishes(variant=name, position=rule if rule in ("offset", "size") else None)
    try:
        convert(original, out, wishes=wishes, overwrite=True, origin=published.origin)
    except WeightsError as error:
        _remove_original(name)
        raise WeightsError(
            f"{published.origin} is not the network '{name}' ({error}); nothing was kept"
        ) from error
    _remove_original(name)


def _bring(name: str, published: PublishedWeights, quiet: bool) -> Path:
    """The published file on this machine, checked."""
    place = place_of_original(name)
    from remind_jax.backbone.hub_connection import HubConnection, mib, sha256_of

    if place.is_file():
        found = sha256_of(place)
        if published.sha256 not in (None, found):
            raise WeightsError(
                f"'{place}' is not the published file of '{name}': its sha256 is {found}, not "
                f"{published.sha256}; remove it, or bring {_address(published)} there"
            )
        return place
    by_hand = f"bring {_address(published)} to '{place}' and run this again"
    try:
        hub = HubConnection()
    except ImportError as error:
        raise WeightsError(
            f"the weights of '{name}' are fetched by huggingface_hub, which is not installed: pip "
            f"install 'remind-jax[hub]', or {by_hand}"
        ) from error
    in_cache = hub.look_in_cache(published)
    if in_cache is not None and published.sha256 in (None, sha256_of(in_cache)):
        return in_cache

    def begin(origin: str, num_bytes: int | None) -> None:
        terms = TERMS[VARIANTS[name].family]
        _say(
            f"fetching the weights of '{name}' ({mib(num_bytes)}) from {origin}; they are "
            f"under the {terms.license} license ({terms.license_url}) and kept in "
            f"'{default_folder()}'",
            quiet,
        )

    make_folder(place.parent)
    partial = place.with_name(place.name + _PARTIAL)
    hub.fetch(published, partial, name=name, by_hand=by_hand, begin=begin, quiet=quiet)
    partial.replace(place)
    return place


def _address(published: PublishedWeights) -> str:
    """Where a person downloads the file."""
    return published.address or (f"{published.page}/resolve/{published.revision}/{published.file}")


def _remove_original(name: str) -> None:
    """Removes what was fetched, if anything; what cannot be removed does no harm."""
    shutil.rmtree(place_of_original(name).parent, ignore_errors=True)


@contextlib.contextmanager
def _alone(path: Path, name: str, quiet: bool) -> Iterator[None]:
    """Waits until no other process fetches the same weights, and keeps others out."""
    lock = FileLock(path, thread_local=False)
    try:
        try:
            lock.acquire(blocking=False)
        except Timeout:
            _say(f"waiting for another process that fetches the weights of '{name}'", quiet)
            lock.acquire()
    except OSError as error:
        raise OutputError(
            f"cannot write '{path}': {error.strerror or error}; give the weights by --weights"
        ) from error
    try:
        yield
    finally:
        lock.release()


def _say(sentence: str, quiet: bool) -> None:
    if not quiet:
        print(printable(sentence), file=sys.stderr)
