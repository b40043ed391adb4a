"""What the process says to the shell."""

from __future__ import annotations

FINE = 0
ERROR = 1  # input, configuration or output is wrong: one sentence on stderr
USAGE = 2  # the words of the command make no sense
INTERRUPTED = 130  # Ctrl-C, after finishing what was done
BROKEN_PIPE = 141  # the reader of our output went away
