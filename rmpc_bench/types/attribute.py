"""An attribute of a base class with a default value that a derived class may replace by a constant or a property."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    attribute = property
else:

    class attribute:
        """Attribute of a base class; the decorated function computes its default from the instance.

        A subclass replaces it by a class attribute, a property, a dataclass field or an assignment in `__init__`.

        Examples
        --------
        >>> class Shape:
        ...     @attribute
        ...     def sides(self):
        ...         return 0
        >>> class Square(Shape):
        ...     sides = 4
        >>> Shape().sides, Square().sides
        (0, 4)
        """

        def __init__(self, default: Callable[[Any], Any]) -> None:
            self.default, self.__doc__ = default, default.__doc__

        def __get__(self, instance: Any, owner: type | None = None) -> Any:
            """Compute the default of an instance; a class has none."""
            if instance is None:
                # `dataclass` takes what it finds on the class for the default of a field of the same name.
                raise AttributeError(f"{self.default.__name__!r} is an attribute of instances")
            return self.default(instance)
