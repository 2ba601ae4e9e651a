"""Checks of types and shapes that are not made twice, in front of jaxtyping's.

jaxtyping checks every call of every function, which in a loop over small arrays takes several times
as long as the work. Where arguments and a result have the types, shapes and kinds of numbers of
some that were right before, they are right again; so are they where their shapes are those with
other sizes in the same places.
"""

from collections.abc import Callable, Collection, Hashable
from functools import cache, partial, wraps
from operator import attrgetter
from re import findall
from types import FunctionType
from typing import Any

import jaxtyping
import numpy as np

Function = Callable[..., Any]
Look = Callable[[Any], Hashable]

VARIES = object()
"""Kind of what is looked at each time, such as a list of items of several kinds."""

FEW = 100
"""Most items of a list that are looked at before it is taken for one of several kinds."""


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

    Most functions are never called, so it is asked at the first call. Functions that another
    defines anew whenever it is called have one memory.
    """
    nested = "<locals>" in function.__qualname__ and not (
        function.__defaults__ or function.__kwdefaults__
    )
    if not nested:
        return Memory(function, checking).of(function)
    place = function.__module__, function.__qualname__, function.__code__
    if place not in NESTED:
        NESTED[place] = Memory(function, checking)
    return NESTED[place].of(function)


class Memory:
    """Cache of a function's type checks, shared by all functions made by one ``def``."""

    def __init__(self, function: FunctionType, checking: Callable[[Function], Function]) -> None:
        # Kinds of arguments, and of results that they had.
        self.right: dict[Hashable, set[Hashable]] = {}
        self.patterns = Patterns(function)
        self.results: list[Any] = []
        self.running: list[Function] = []
        self.kinds = KINDS[tells_texts(function)]
        results, running = self.results, self.running

        def known(*args: Any, **kwargs: Any) -> Any:
            return results.pop() if results else running[-1](*args, **kwargs)

        @cache
        def checked() -> Function:
            # Annotations that are text are looked up where the function is.
            here = FunctionType(known.__code__, function.__globals__, closure=known.__closure__)
            return checking(wraps(function)(here))

        self.checked = checked

    def of(self, function: FunctionType) -> Function:
        """Wrap one of these functions so that its calls are checked."""
        right, results, running = self.right, self.results, self.running
        kinds, checked, patterns, config = self.kinds, self.checked, self.patterns, jaxtyping.config

        @wraps(function)
        def called(*args: Any, **kwargs: Any) -> Any:
            if config.jaxtyping_disable:
                return function(*args, **kwargs)
            each: list[Hashable] = []  # filled faster by a loop than by a comprehension
            for one in (*args, *kwargs.values()) if kwargs else args:
                each.append(kinds[type(one)](one))  # noqa: PERF401
            given = (*each, tuple(kwargs)) if kwargs else tuple(each)
            found = right.get(given)
            if found is None and VARIES not in given and patterns.knows(given):
                found = right[given] = set()
            if found is None:
                running.append(function)
                try:
                    result = checked()(*args, **kwargs)
                finally:
                    running.pop()
            else:
                result = function(*args, **kwargs)
                kind = kinds[type(result)](result)
                if kind in found:
                    return result
                if kind is not VARIES and patterns.knows((given, kind)):
                    found.add(kind)
                    return result
                results.append(result)
                checked()(*args, **kwargs)
            if VARIES not in given:
                found = right.setdefault(given, set())
                if (kind := kinds[type(result)](result)) is not VARIES:
                    found.add(kind)
                patterns.add(given, kind)
            return result

        return called


class Patterns:
    """Cache of shape-checked calls, in which calls that differ only in free sizes are the same.

    A size is free where no annotation names it: which free sizes are equal counts, not how large.
    """

    def __init__(self, function: FunctionType) -> None:
        asked = [*function.__annotations__.values()]
        told = " ".join(map(repr, asked))
        self._named = {0, 1, *map(int, findall(r"\d+", told))}
        # Sizes are reckoned with, or what is asked of them stands elsewhere.
        self._exact = bool(findall(r"\w[*+/-]\w|ForwardRef", told)) or any(
            isinstance(one, str) for one in asked
        )
        self._known: set[Hashable] = set()

    def knows(self, kind: tuple[Hashable, ...]) -> bool:
        """Whether one of the same pattern was right."""
        return not self._exact and self._pattern(kind, {}) in self._known

    def add(self, given: tuple[Hashable, ...], kind: Hashable) -> None:
        """Remember arguments that were right, and the result."""
        if not self._exact:
            both = self._pattern((given, kind), {})
            self._known |= {both[0], both}

    def _pattern(self, kind: tuple[Hashable, ...], sizes: dict[int, int]) -> tuple[Hashable, ...]:
        """A call's types and sizes, with the free sizes numbered -1, -2, ... as they appear."""
        found: list[Hashable] = []
        for one in kind:
            if type(one) is int and one not in self._named:
                found.append(sizes.setdefault(one, -1 - len(sizes)))
            else:
                found.append(self._pattern(one, sizes) if isinstance(one, tuple) else one)
        return tuple(found)


NESTED: dict[Hashable, Memory] = {}
"""Memories of functions that others define, by where that is."""


def tells_texts(function: FunctionType) -> bool:
    """Whether annotations may ask for some texts and not for others."""
    asked = [*function.__annotations__.values()]
    return any(isinstance(one, str) for one in asked) or any(
        name in repr(one) for one in asked for name in ("Literal", "Annotated", "ForwardRef")
    )


class Kinds(dict[type, Look]):
    """Dispatch table: for each type a function that gives the properties annotations check.

    Those of a text are its type, or the text itself where annotations name texts.
    """

    def __init__(self, texts: bool) -> None:
        super().__init__({bytes: type, range: type, str: itself if texts else type})
        self |= {list: self.alike, set: self.alike, frozenset: self.alike, dict: self.mapped}
        self[np.ndarray] = attrgetter("dtype", "shape")  # no other type has numpy's dtypes alone

    def __missing__(self, kind: type) -> Look:
        """Choose and store the function for a new type."""
        look: Look = varying if issubclass(kind, Collection) else type
        if not {"ndarray", "Tensor"}.isdisjoint(base.__name__ for base in kind.__mro__):
            look = ARRAY
        elif issubclass(kind, type):
            look = itself
        elif issubclass(kind, tuple):
            look = self.in_order
        self[kind] = look
        return look

    def in_order(self, items: tuple[Any, ...]) -> Hashable:
        """Kind of a tuple."""
        found = (type(items), *[self[type(one)](one) for one in items])
        return VARIES if VARIES in found else found

    def alike(self, items: Collection[Any]) -> Hashable:
        """Kind of items; where they differ, a check that looks at one of them tells nothing."""
        found = {self[type(one)](one) for one in items} if len(items) <= FEW else {VARIES}
        return VARIES if len(found) > 1 or VARIES in found else (type(items), *found)

    def mapped(self, items: dict[Any, Any]) -> Hashable:
        """Kind of keys and values."""
        # No annotation names the texts of keys.
        found = (dict, KINDS[False].alike([*items]), self.alike([*items.values()]))
        return VARIES if VARIES in found else found


ARRAY = attrgetter("__class__", "dtype", "shape")
"""Kind of numpy's arrays and torch's tensors, and of what is derived from them."""


def itself(value: Hashable) -> Hashable:
    """Kind of texts and types."""
    return value


def varying(value: Any) -> Hashable:
    """Kind of other collections, whose items are not looked at: their checks are not cached."""
    return VARIES


KINDS = {texts: Kinds(texts) for texts in (True, False)}
