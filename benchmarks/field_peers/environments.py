"""Trackers of others, each in a virtual environment of its own: what is installed, what is run.

Nothing here is a requirement of the project, and nothing of theirs is imported by it: their
adapters, the modules beside this one, run as processes of those environments.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path
from typing import Any

from remind_jax.files import user_cache_folder

ROOT = Path(__file__).resolve().parent.parent.parent
_READY = "ready.json"
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_MOST_INSTALL_S, _MOST_RUN_S = 1800, 5400
# A build for the CPU, where pip is set up to find one; otherwise the default one, several GB.
_TORCH = ("torch==2.13.0", "torchvision==0.28.0")


@dataclasses.dataclass(frozen=True)
class Peer:
    """A package with trackers."""

    name: str
    requirements: tuple[str, ...]
    license: str
    first: tuple[str, ...] = ()  # installed before the rest, which then takes what is there


PEERS = {
    peer.name: peer
    for peer in (
        Peer("trackers", ("trackers==2.6.1",), "Apache-2.0"),
        Peer("boxmot", ("boxmot==25.0.0", *_TORCH), "AGPL-3.0", first=_TORCH),
        Peer("ultralytics", ("ultralytics==8.4.190", "lap", *_TORCH), "AGPL-3.0", first=_TORCH),
        Peer("norfair", ("norfair==2.3.0",), "BSD-3-Clause"),
    )
}


def add_peer_options(parser: argparse.ArgumentParser) -> None:
    """Options that say which peers are asked, and where their environments are."""
    parser.add_argument("--peers", nargs="*", choices=[*PEERS, "none"], help="all if left out")
    parser.add_argument(
        "--environments",
        type=Path,
        default=user_cache_folder() / "field-peers",
        help="folder of the environments of peers",
    )


def chosen_peers(given: list[str] | None) -> list[str]:
    """Names of the peers that `--peers` asks for."""
    return [] if given == ["none"] else given or list(PEERS)


class AbsentError(Exception):
    """A peer cannot be had here; the message says why."""


def prepare(peer: Peer, folder: Path) -> Path:
    """The interpreter of a peer's environment, made if it is not there.

    Raises:
      AbsentError: If the environment cannot be made.
    """
    home = folder / f"{peer.name}-py{sys.version_info[0]}{sys.version_info[1]}"
    python = home / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    wanted = [*peer.first, *peer.requirements]
    if (home / _READY).is_file() and json.loads((home / _READY).read_text()) == wanted:
        return python
    shutil.rmtree(home, ignore_errors=True)
    try:
        venv.create(home, with_pip=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise AbsentError(f"no environment could be made: {error}") from error
    for some in filter(None, (peer.first, peer.requirements)):
        _call([python, "-m", "pip", "install", "--quiet", *some], _MOST_INSTALL_S, "installing")
    (home / _READY).write_text(json.dumps(wanted))
    return python


def ask(peer: Peer, python: Path, sequences: Path, out: Path) -> dict[str, Any]:
    """Has a peer answer all sequences with all its settings; its report.

    Raises:
      AbsentError: If its process fails.
    """
    out.mkdir(parents=True, exist_ok=True)
    module = f"benchmarks.field_peers.{peer.name}_trackers"
    _call([python, "-m", module, sequences.resolve(), out.resolve()], _MOST_RUN_S, "running")
    return json.loads((out / "report.json").read_text())


def _call(command: list[Any], most_s: float, doing: str) -> None:
    words = [str(word) for word in command]
    # Of our own environment nothing may leak into theirs.
    kept = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    try:
        done = subprocess.run(
            words, cwd=ROOT, env=kept | _ONE_THREAD, timeout=most_s, text=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        raise AbsentError(f"{doing} failed: {error}") from error
    if done.returncode:
        last = [line for line in done.stderr.splitlines() if line.strip()][-1:] or ["no message"]
        raise AbsentError(f"{doing} failed: {last[0].strip()}")
