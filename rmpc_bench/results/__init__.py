"""What a directory of results holds, read without a design: records, tables, evaluations, comparisons of two."""
