"""Everything stored or received is read here: types, sizes and names are checked before anything uses a value.

| format | read by |
|---|---|
| regular files of limited size, JSON: manifest, progress, published, tuning, claims | `plain_files` |
| trials.sqlite | `store` |
| names in them, as in a configuration | `names` |
| archives of `pack` | `archive` |
| arrays and tables: .npz, .mat, .csv | `arrays` |
| tables of runs made elsewhere: .csv, .csv.gz, .parquet | `run_table` |
| what may execute; the one start of git | `consent` |
"""
