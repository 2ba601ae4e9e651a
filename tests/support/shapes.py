"""Checks of types and shapes that are not made twice, in front of jaxtyping's.

jaxtyping checks every call of every function, which in a loop over small arrays takes several times
as long as the work. Where arguments and a result have the types, shapes and kinds of numbers of
some that were right before, they are right again.
"""

from collections.abc import Callable, Collection, Hashable
from functools import cache, partial, wraps
from types import FunctionType
from typing import Any

import jaxtyping

Function = Callable[..., Any]

VARIES = object()
"""Kind of what is looked at each time, such as a list, whose items may be anything."""


def check_once() -> None:
    """Put this in front of jaxtyping's decorator, for what is imported from now on."""
    decorate = jaxtyping.jaxtyped

    def jaxtyped(function: Any = None, *, typechecker: Any) -> Any:
        if function is None:
            return partial(jaxtyped, typechecker=typechecker)
        if not isinstance(function, FunctionType):  # a class, a property: comes back with functions
            return decorate(function, typechecker=typechecker)
        return remembering(function, lambda one: decorate(one, typechecker=typechecker))

    for module in (jaxtyping, jaxtyping._decorator):
        vars(module)["jaxtyped"] = jaxtyped


def remembering(function: FunctionType, checking: Callable[[Function], Function]) -> Function:
    """A function whose calls are checked by what ``checking`` makes of it, each kind of call once.

    Most functions are never called, so it is asked at the first call.
    """
    right: set[Hashable] = set()
    results: list[Any] = []

    def known(*args: Any, **kwargs: Any) -> Any:
        return results.pop() if results else function(*args, **kwargs)

    @cache
    def checked() -> Function:
        # Annotations that are text are looked up where the function is.
        here = FunctionType(known.__code__, function.__globals__, closure=known.__closure__)
        return checking(wraps(function)(here))

    @wraps(function)
    def called(*args: Any, **kwargs: Any) -> Any:
        if jaxtyping.config.jaxtyping_disable:
            return function(*args, **kwargs)
        given = *map(kind_of, args), *kwargs, *map(kind_of, kwargs.values())
        if given not in right:
            result = checked()(*args, **kwargs)
        else:
            result = function(*args, **kwargs)
            if (given, kind_of(result)) in right:
                return result
            results.append(result)
            checked()(*args, **kwargs)
        kind = given, kind_of(result)
        if VARIES not in given:
            right.add(given)
            if kind[1] is not VARIES:
                right.add(kind)
        return result

    return called


def kind_of(value: Any) -> Hashable:
    """All of a value that an annotation can ask for."""
    kind: Any = type(value)
    if is_array(kind):
        return kind, value.dtype, value.shape
    if kind is str or issubclass(kind, type):
        return value
    if kind is tuple:
        kinds = (*map(kind_of, value),)
        return VARIES if VARIES in kinds else kinds
    return VARIES if is_container(kind) else kind


@cache
def is_array(kind: type) -> bool:
    """Whether a type is numpy's array or torch's tensor, or derived from them."""
    return not {"ndarray", "Tensor"}.isdisjoint(base.__name__ for base in kind.__mro__)


@cache
def is_container(kind: type) -> bool:
    """Whether values of a type have items, which annotations may tell more of."""
    return issubclass(kind, Collection)
