"""What a configuration may contain: a JSON Schema for editors, and the texts of `describe`."""
