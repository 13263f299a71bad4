"""Exit statuses of the commands."""

ALL_OK, SOME_FAILED, NOTHING_RAN, INTERRUPTED, TERMINATED = 0, 1, 2, 130, 143
