"""The checks of types and shapes in tests refuse as much as jaxtyping's, whatever came before."""

from collections.abc import Sequence

import numpy as np
import pytest
from beartype import beartype
from jaxtyping import Float, TypeCheckError, jaxtyped
from shapes import remembering

SQUARE = np.ones((2, 2))


def first(
    one: Float[np.ndarray, "n n"], many: int = 2, names: Sequence[str] = ()
) -> Float[np.ndarray, "n"]:  # noqa: F821
    return one.ravel()[:many]


@pytest.fixture
def checks():
    """A type-checked function, and a list of the arguments that were really checked."""
    made = []

    def checking(function):
        inner = jaxtyped(function, typechecker=beartype)
        return lambda *args: made.append(args) or inner(*args)

    return remembering(first, checking), made


@pytest.mark.parametrize(
    "wrong",
    [
        (np.ones((2, 3)),),
        (SQUARE.astype(int),),
        ([[1.0]],),
        (SQUARE, 3),  # as right as others, but its result is not
        (SQUARE, "2"),
        (SQUARE, 2, [1]),
        (SQUARE, 2, (1,)),
        (SQUARE, 2, 1),
    ],
)
def test_what_is_wrong_is_refused_after_what_was_right(checks, wrong):
    function, _ = checks
    for right in [(SQUARE,), (SQUARE, 2), (SQUARE, 2, ["a"]), (SQUARE, 2, ("a",))]:
        assert np.array_equal(function(*right), [1.0, 1.0])
    for _ in range(2):
        with pytest.raises(TypeCheckError):
            function(*wrong)


def test_a_kind_of_call_is_checked_once(checks):
    function, made = checks
    for k in range(3):
        assert function(k * SQUARE)[0] == k
    assert len(made) == 1
    for _ in range(3):
        assert function(np.ones((3, 3)), 3).shape == (3,)
    assert len(made) == 2
