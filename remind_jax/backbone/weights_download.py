"""Published weights by name: fetched once, checked, converted and kept (backbones.md#by-name).

`huggingface_hub` fetches what is on the hub, with all of its variables. The checkpoint lies in
`weights/NAME/` beside the converted files until it is converted. One process fetches, others wait.
"""

from __future__ import annotations

import contextlib
import hashlib
import shutil
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from remind_jax.backbone.published_weights import PUBLISHED, PublishedWeights
from remind_jax.backbone.vit_variants import TERMS, VARIANTS
from remind_jax.backbone.vit_weights import default_folder, find_weights, look_for_weights
from remind_jax.errors import OutputError, WeightsError, first_line, printable
from remind_jax.files import make_folder, replacing

_TIMEOUT_S = 60.0  # of an authors' server, without a byte


def obtain_weights(name: str, given: str | Path | None = None, *, quiet: bool = False) -> Path:
    """Where the converted weights of a named network are; fetches those that are nowhere yet.

    Args:
      given: A file or folder, which must hold them; looked for as `vit_weights.look_for_weights`
        says if left out, and fetched if there are none.

    Raises:
      WeightsError: If there are none, and they cannot be fetched or are not the published ones.
      OutputError: If they cannot be kept.
    """
    found, _ = look_for_weights(name, given)
    if found is not None or given is not None or name not in PUBLISHED:
        return found or find_weights(name, given)
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
    wishes = Wishes(variant=name, position=rule if rule in ("offset", "size") else None)
    original = _original(name, published, quiet)
    try:
        convert(original, out, wishes=wishes, overwrite=True, origin=published.origin)
    except WeightsError as error:
        raise WeightsError(
            f"{published.origin} is not the network '{name}' ({error}); nothing was kept"
        ) from error
    finally:
        shutil.rmtree(place_of_original(name).parent, ignore_errors=True)


def _original(name: str, published: PublishedWeights, quiet: bool) -> Path:
    """The published file on this machine, checked: brought by hand, in the hub's cache, or new."""
    place = place_of_original(name)
    address = published.address or f"{published.page}/resolve/{published.revision}/{published.file}"
    by_hand = f"bring {address} to '{place}' and run this again"
    if place.is_file():
        if wrong := _wrong_hash(place, published):
            raise WeightsError(
                f"'{place}' is not the published file of '{name}': {wrong}; remove it, or {by_hand}"
            )
        return place
    if published.repository is not None:
        try:
            from huggingface_hub import try_to_load_from_cache
        except ImportError as error:
            raise WeightsError(
                f"the weights of '{name}' are fetched by huggingface_hub, which is not installed: "
                f"pip install 'remind-jax[hub]', or {by_hand}"
            ) from error
        cached = try_to_load_from_cache(
            published.repository, published.file, revision=published.revision
        )
        if isinstance(cached, str) and not _wrong_hash(Path(cached), published):
            return Path(cached)  # other programs have it there, and go on to
    terms = TERMS[VARIANTS[name].family]
    size = f"{published.num_bytes / 2**20:.1f} MiB" if published.num_bytes else "of unknown size"
    _say(
        f"fetching the weights of '{name}' ({size}) of {published.origin}; they are under the "
        f"{terms.license} license ({terms.license_url}) and kept in '{default_folder()}'",
        quiet,
    )
    make_folder(place.parent)
    try:
        _fetch(published, place, quiet)
    except Exception as error:  # of the library, of the connection or of the disk
        shutil.rmtree(place.parent, ignore_errors=True)
        gated = (
            f"they are given out on request: ask for access at {published.page}, then set HF_TOKEN "
            f"or run 'hf auth login', and run this again; or {by_hand}"
        )
        raise WeightsError(
            f"there are no weights for '{name}', and {published.origin} cannot be fetched "
            f"({first_line(error)}): {gated if published.is_gated else f'try again, or {by_hand}'}"
        ) from error
    if wrong := _wrong_hash(place, published):
        shutil.rmtree(place.parent, ignore_errors=True)
        raise WeightsError(
            f"{address} is not the published file of '{name}': {wrong}; nothing was kept: try "
            f"again, or {by_hand}"
        )
    return place


def _fetch(published: PublishedWeights, place: Path, quiet: bool) -> None:
    if published.address is not None:
        with (
            urllib.request.urlopen(published.address, timeout=_TIMEOUT_S) as response,
            replacing(place) as partial,
            partial.open("wb") as file,
        ):
            shutil.copyfileobj(response, file)
        return
    from huggingface_hub import hf_hub_download, utils

    was_shown = not utils.are_progress_bars_disabled()
    if quiet and was_shown:
        utils.disable_progress_bars()
    try:
        hf_hub_download(
            str(published.repository),
            published.file,
            revision=published.revision,
            local_dir=place.parent,
            cache_dir=place.parent,  # what lies in the user's was compared already
            library_name="remind-jax",
        )
    finally:
        if quiet and was_shown:
            utils.enable_progress_bars()


def _wrong_hash(path: Path, published: PublishedWeights) -> str:
    """What is wrong with the bytes of a file; nothing if they are the published ones."""
    with path.open("rb") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    is_right = published.sha256 in (None, found)
    return "" if is_right else f"its sha256 is {found}, not {published.sha256}"


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
