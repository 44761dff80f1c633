"""Recorded runs from csv and npz files: measurements, inputs and states of experiments that took place elsewhere."""
