"""Statements of papers: expressions, evaluation, findings."""
