"""Exit statuses of the command line."""

FINE, NO, BAD = 0, 1, 2
INTERRUPTED = 130
