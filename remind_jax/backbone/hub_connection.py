"""Files of the Hugging Face hub and of authors' servers, over as many connections as it takes.

`huggingface_hub` brings the connection: HF_ENDPOINT, HF_HUB_OFFLINE, the token (HF_TOKEN, or as
`hf auth login` left it below HF_HOME), proxies, certificates. One way to receive serves both kinds
of servers, so that a stopped download goes on and everything is checked alike.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import remind_jax
from remind_jax.backbone.published_weights import PublishedWeights
from remind_jax.errors import OutputError, RemindError, WeightsError, first_line

_MOST_TRIES = 4  # in a row that bring nothing, before a download is given up
_BETWEEN_TRIES_S = 1.0
_IDENTITY: dict[str, Any] = {
    "library_name": "remind-jax",
    "library_version": remind_jax.__version__,
}


class HubConnection:
    """What is asked of `huggingface_hub`, the same in its versions 1 and 2.

    Raises:
      ImportError: If it is not installed.
    """

    def __init__(self) -> None:
        import huggingface_hub
        from huggingface_hub import constants, errors, utils

        self._library: Any = huggingface_hub
        self._constants, self._errors, self._utils = constants, errors, utils
        self._session: Any = utils.get_session()
        # httpx in version 1, httpx2 in version 2.
        transport: Any = sys.modules[type(self._session).__module__.partition(".")[0]]
        self._failures = (transport.HTTPError, errors.HfHubHTTPError, ConnectionError)

    def look_in_cache(self, published: PublishedWeights) -> Path | None:
        """The file as other programs fetched it before, if they did."""
        if published.repository is None:
            return None
        found = self._library.try_to_load_from_cache(
            published.repository, published.file, revision=published.revision
        )
        return Path(found) if isinstance(found, str) else None

    def fetch(
        self,
        published: PublishedWeights,
        partial: Path,
        *,
        name: str,
        by_hand: str,
        begin: Callable[[str, int | None], None],
        quiet: bool,
    ) -> None:
        """Fetches a file, or the rest of it, and checks it.

        Args:
          published: Which one.
          partial: Where it is written; what is there already counts as received.
          name: Of the network, for messages.
          by_hand: Half a sentence: how it comes here without a connection.
          begin: Called once the server agrees, with where the file comes from and its bytes.
          quiet: Show no progress.

        Raises:
          WeightsError: If it cannot be had or is another one.
          OutputError: If it cannot be written.
        """
        if self._constants.HF_HUB_OFFLINE:
            raise WeightsError(
                f"there are no weights for '{name}', and HF_HUB_OFFLINE forbids to fetch them: "
                f"unset it, or {by_hand}"
            )
        try:
            with _silenced():
                address, num_bytes = self._ask(published)
                _check_room(partial, num_bytes)
                begin(self._origin(published), num_bytes)
                headers = self._headers(published)
                with _progress(name, num_bytes, quiet) as show:
                    self._receive_all(address, headers, partial, num_bytes, show)
        except self._failures as error:
            raise self._explain(error, published, name, by_hand, size_of(partial)) from error
        found = sha256_of(partial)
        if published.sha256 not in (None, found):
            partial.unlink()
            raise WeightsError(
                f"what {_server(address)} has as the weights of '{name}' is not the published "
                f"file: its sha256 is {found}, not {published.sha256}; nothing was kept: try "
                f"again, or {by_hand}"
            )

    def _ask(self, published: PublishedWeights) -> tuple[str, int | None]:
        """Address and size of a file, as far as known."""
        if published.repository is None:
            return str(published.address), published.num_bytes
        address = self._library.hf_hub_url(
            published.repository,
            published.file,
            revision=published.revision,
            endpoint=self._constants.ENDPOINT,
        )
        told = self._library.get_hf_file_metadata(
            address, timeout=self._constants.HF_HUB_ETAG_TIMEOUT, **_IDENTITY
        )
        return address, told.size or published.num_bytes

    def _origin(self, published: PublishedWeights) -> str:
        """Where a file comes from, by the server that is asked: a mirror has its own name."""
        return published.address or f"{self._constants.ENDPOINT}/{published.repository}"

    def _headers(self, published: PublishedWeights) -> dict[str, str]:
        """The token is for the hub alone; redirected elsewhere, the library's client drops it."""
        if published.repository is None:
            return {}
        return self._utils.build_hf_headers(**_IDENTITY)

    def _receive_all(
        self,
        address: str,
        headers: dict[str, str],
        partial: Path,
        num_bytes: int | None,
        show: Callable[[int], None],
    ) -> None:
        """Receives a file; a connection that breaks is followed by another while bytes come."""
        failures = 0
        while True:
            before = size_of(partial)
            try:
                return self._receive(address, headers, partial, num_bytes, show)
            except self._failures as error:
                failures = 1 if size_of(partial) > before else failures + 1
                if isinstance(error, self._errors.HfHubHTTPError) or failures >= _MOST_TRIES:
                    raise
            time.sleep(_BETWEEN_TRIES_S)

    def _receive(
        self,
        address: str,
        headers: dict[str, str],
        partial: Path,
        num_bytes: int | None,
        show: Callable[[int], None],
    ) -> None:
        """Receives what is missing of a file over one connection."""
        received = size_of(partial)
        if num_bytes is not None and received >= num_bytes:
            return  # what is too long fails the check
        wanted = {**headers, "Accept-Encoding": "identity"}
        if received:
            wanted["Range"] = f"bytes={received}-"
        with self._session.stream(
            "GET",
            address,
            headers=wanted,
            timeout=self._constants.HF_HUB_DOWNLOAD_TIMEOUT,
            follow_redirects=True,
        ) as response:
            if response.status_code == 416:
                partial.unlink(missing_ok=True)
                raise ConnectionError("the server cannot go on where it stopped")
            self._utils.hf_raise_for_status(response)
            goes_on = response.status_code == 206
            received = received if goes_on else 0
            with _writing(partial), partial.open("ab" if goes_on else "wb") as file:
                for block in response.iter_bytes():
                    received += len(block)
                    file.write(block)
                    show(received)
                    if num_bytes is not None and received > num_bytes:
                        return
        if num_bytes is not None and received < num_bytes:
            raise ConnectionError("the connection was closed before the end")

    def _explain(
        self, error: Exception, published: PublishedWeights, name: str, by_hand: str, received: int
    ) -> RemindError:
        """What went wrong on the way, in one sentence."""
        status = getattr(getattr(error, "response", None), "status_code", None)
        server = _server(published.address or self._constants.ENDPOINT)
        if published.is_gated and status in (401, 403):
            if self._library.get_token() is None:
                why = "no token is set"
            elif status == 401:
                why = "the token that is set is not accepted"
            else:
                why = "the account of the token that is set has no access yet"
            return WeightsError(
                f"the weights of '{name}' are given out on request, and {why}: ask for access at "
                f"{published.page}, then set HF_TOKEN or run 'hf auth login', and run this again"
            )
        if status in (401, 403):
            return WeightsError(
                f"{server} refuses to give out {published.origin} (answer {status}): correct or "
                f"unset HF_TOKEN, or {by_hand}"
            )
        if status == 404:
            return WeightsError(
                f"{server} has no {published.origin}: unset HF_ENDPOINT if it is set, or {by_hand}"
            )
        what = f"it answers {status}" if status else first_line(error)
        if received:
            return WeightsError(
                f"the weights of '{name}' stopped coming from {server} after {mib(received)} "
                f"({what}); these are kept: run this again to go on, or {by_hand}"
            )
        return WeightsError(
            f"there are no weights for '{name}', and they cannot be fetched from {server} "
            f"({what}): try again with a connection, or {by_hand}"
        )


def sha256_of(path: Path) -> str:
    """Of the bytes of a file, in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def size_of(path: Path) -> int:
    """Bytes of a file, 0 if there is none."""
    return path.stat().st_size if path.is_file() else 0


def mib(num_bytes: int | None) -> str:
    """A size in words."""
    return "of unknown size" if num_bytes is None else f"{num_bytes / 2**20:.1f} MiB"


@contextlib.contextmanager
def _silenced() -> Iterator[None]:
    """Keeps the library from warning of what is told in our words."""
    logger = logging.getLogger("huggingface_hub")
    former = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(former)


@contextlib.contextmanager
def _progress(name: str, num_bytes: int | None, quiet: bool) -> Iterator[Callable[[int], None]]:
    """A bar on a terminal, nothing elsewhere; called with the bytes so far."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        DownloadColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
        TransferSpeedColumn,
    )

    console = Console(stderr=True)
    bars = Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=16),
        DownloadColumn(binary_units=True),
        TransferSpeedColumn(),
        TimeRemainingColumn(compact=True),
        console=console,
        disable=quiet or not console.is_terminal,
        transient=True,
    )
    task = bars.add_task(name, total=num_bytes)
    with bars:
        yield lambda received: bars.update(task, completed=received)


@contextlib.contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Turns what the system says of a failed write into one sentence; others pass."""
    try:
        yield
    except OSError as error:
        if error.errno is None or isinstance(error, ConnectionError):
            raise
        raise _no_room(path, str(error.strerror)) from error


def _check_room(partial: Path, num_bytes: int | None) -> None:
    """Raises an `OutputError` unless the rest of a file and its conversion have room."""
    needed = 2 * (num_bytes or 0) - size_of(partial)
    free = shutil.disk_usage(partial.parent).free
    if free < needed:
        raise _no_room(partial, f"{mib(needed)} are needed for a while, {mib(free)} are free")


def _no_room(path: Path, why: str) -> OutputError:
    return OutputError(
        f"cannot write '{path}': {why}; make room, or name another cache folder by XDG_CACHE_HOME"
    )


def _server(address: str) -> str:
    """The part of an address that names the server."""
    return "/".join(address.split("/")[:3])
