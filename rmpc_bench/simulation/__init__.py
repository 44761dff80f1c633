"""Simulation of one block of runs in one process; it writes no files."""
