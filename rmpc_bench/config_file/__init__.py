"""A YAML file with the place of everything: reading, inheriting, and from annotations to checked values of keys."""
