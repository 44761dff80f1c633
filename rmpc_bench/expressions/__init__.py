"""Arithmetic in configurations: one tokeniser and one parser, under quantities and under the checks of claims."""
