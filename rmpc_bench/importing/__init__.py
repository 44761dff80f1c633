"""Runs that were made elsewhere: a table of runs becomes a directory of results, without any simulation."""
