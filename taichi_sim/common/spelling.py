"""Other spellings of arguments."""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

__all__ = ["takes_color"]

Function = TypeVar("Function", bound=Callable[..., Any])


def takes_color(function: Function) -> Function:
    """A function whose argument `colour` may also be written `color`; its signature names the first alone."""

    @wraps(function)
    def either(*args: Any, **kwargs: Any) -> Any:
        if "color" in kwargs:
            if "colour" in kwargs:
                raise TypeError(f"{function.__name__}() got colour and color, which are the same; give one of them")
            kwargs["colour"] = kwargs.pop("color")
        return function(*args, **kwargs)

    return either  # type: ignore[return-value]
