"""The stored bytes of an experiment: trials.sqlite, which one process writes and any may read.

| table of trials.sqlite | read and written in |
|---|---|
| meta, arrays, methods, traces | `store` |
| columns, chunks: statuses, metrics, sampled values | `columns` |
| failures, held, failed_steps, warnings, durations, ensemble_groups | `rows` |
| keys: the number of every hash and name; transactions | `file` |
| all, from the store of a shard | `copying` |

`received.store` has the statements that make the tables, and refuses files and values that no store has.
"""
