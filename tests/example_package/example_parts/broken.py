"""A module that cannot be imported."""

import no_such_library_of_anybody  # noqa: F401


class Filter:
    """Never reached."""
