"""Noise laws and distributions of uncertain quantities."""
