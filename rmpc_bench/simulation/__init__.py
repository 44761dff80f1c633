"""One block of runs, one process, no files."""
