"""Fuzzes everything that enters from a file, for some time, and prints what became of it.

python -m tests.corpus.fuzz --seconds 300 [--formats "configuration,memory"] [--seed 7]
"""

import argparse
import itertools
import sys
import time

from tests.corpus.judge import GOOD, LIMIT_S, count, load_libraries, run_case
from tests.corpus.seeds import FORMATS


def main() -> int:
    """Exit status 1 if anything ended otherwise than refused in a sentence, or accepted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--rounds", type=int, help="at most so many cases of each format")
    parser.add_argument("--formats", default=",".join(FORMATS))
    parser.add_argument("--seed", type=int, default=0, help="of the first case of each format")
    parser.add_argument("--limit-s", type=float, default=LIMIT_S, help="of one case")
    options = parser.parse_args()
    names, deadline = options.formats.split(","), time.monotonic() + options.seconds
    verdicts = []
    load_libraries()
    seeds = itertools.islice(itertools.count(options.seed), options.rounds)
    for seed, name in ((seed, name) for seed in seeds for name in names):
        verdicts.append((name, seed, run_case(name, seed, options.limit_s, in_child=True)))
        if time.monotonic() > deadline:
            break
    print(f"{len(verdicts)} cases, seeds {options.seed} to {seed}\n\n{count(verdicts)}")
    return int(any(verdict.kind not in GOOD for _, _, verdict in verdicts))


if __name__ == "__main__":
    sys.exit(main())
