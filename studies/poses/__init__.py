"""Which poses: random, by condition number, by observability index, by A, D and E; the error that each leads to."""
