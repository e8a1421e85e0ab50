"""Other spellings of arguments."""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

__all__ = ["takes_center", "takes_centre", "takes_color"]

Function = TypeVar("Function", bound=Callable[..., Any])


def _also(other: str, name: str) -> Callable[[Function], Function]:
    """A decorator of functions whose argument `name` may also be written `other`; their signatures have `name` alone."""

    def takes(function: Function) -> Function:
        @wraps(function)
        def either(*args: Any, **kwargs: Any) -> Any:
            if other in kwargs:
                if name in kwargs:
                    raise TypeError(
                        f"{function.__name__}() got {name} and {other}, which are the same; give one of them"
                    )
                kwargs[name] = kwargs.pop(other)
            return function(*args, **kwargs)

        return either  # type: ignore[return-value]

    return takes


takes_color = _also("color", "colour")
takes_center = _also("center", "centre")
takes_centre = _also("centre", "center")
