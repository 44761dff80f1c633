"""Speed and memory of the bench beside plainly written programs: ``make perf`` writes the table."""
