"""Runs the benchmark and writes its tables into docs/benchmark.md, between their marks.

    python docs/leaderboard.py                    twelve rendered tours
    python docs/leaderboard.py --real DATA_ROOT   sequences with annotations that you have

Results are kept in benchmarks-out/, so that a second run only adds what is missing.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.pages import fill_file
from remind_jax.cli.main import main as remind

PAGE = Path(__file__).with_name("benchmark.md")


def main() -> int:
    """Runs, and rewrites the page; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--real", metavar="DATA_ROOT", help="sequences that you have")
    parser.add_argument("--out", type=Path, default=Path("benchmarks-out"))
    parser.add_argument("--write-only", action="store_true", help="the tables that are there")
    options = parser.parse_args()
    name = "rendered" if options.real is None else "real"
    out = options.out / name
    words = ["benchmark", *([options.real] if options.real else []), "--out", str(out)]
    if not options.write_only and (code := remind(words)):
        return code
    tables = sorted((out / "tables").glob("*.md"))
    fill_file(PAGE, {f"{name}:{one.stem}": one.read_text(encoding="utf-8") for one in tables})
    return 0


if __name__ == "__main__":
    sys.exit(main())
