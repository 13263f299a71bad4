"""Exit statuses of the commands."""

ALL_OK, SOME_FAILED, NOTHING_RAN, INTERRUPTED = 0, 1, 2, 130
