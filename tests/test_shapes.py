"""The checks of types and shapes in tests refuse as much as jaxtyping's, whatever came before."""

from collections.abc import Sequence
from typing import Literal

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


def remembered(function):
    """A type-checked function, and a list of the arguments that were really checked."""
    made = []

    def checking(function):
        inner = jaxtyped(function, typechecker=beartype)
        return lambda *args: made.append(args) or inner(*args)

    return remembering(function, checking), made


@pytest.fixture
def checks():
    return remembered(first)


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


def pairs(
    one: Float[np.ndarray, "*batch n 3"],
    other: Float[np.ndarray, "n k"],
    cut: int = 0,
) -> Float[np.ndarray, "n"]:  # noqa: F821
    return other.sum(axis=1)[cut:]


def halves(one: Float[np.ndarray, "n"], other: Float[np.ndarray, "2*n"]) -> float:  # noqa: F821
    return float(other.sum() / one.sum())


def test_other_sizes_in_the_same_places_are_right_and_in_others_are_not():
    (function, made), (other, made_too) = remembered(pairs), remembered(halves)
    for n, k in ((2, 4), (7, 5), (50, 90)):
        assert function(np.ones((6, n, 3)), np.ones((n, k))).shape == (n,)
    assert len(made) == 1
    function(np.ones((6, 9, 3)), np.ones((9, 9)))  # sizes that are equal by chance
    function(np.ones((5, 9, 3)), np.ones((9, 3)))  # one that is named
    assert len(made) == 3
    for sizes in (((6, 8, 3), (9, 5)), ((6, 8, 4), (8, 5)), ((9, 8, 3), (3, 9)), ((8, 3), (6, 8))):
        with pytest.raises(TypeCheckError):
            function(*map(np.ones, sizes))
    with pytest.raises(TypeCheckError):
        function(np.ones((6, 7, 3)), np.ones((7, 4)), 1)  # a result of another size
    for n in (2, 3):
        assert other(np.ones(n), np.ones(2 * n)) == 2
        with pytest.raises(TypeCheckError):
            other(np.ones(n), np.ones(2 * n + 1))
    assert len(made_too) == 4


def total(
    many: list[Float[np.ndarray, "n"]],  # noqa: F821
    names: dict[str, int],
    how: Literal["sum", "most"] = "sum",
) -> float:
    return float(sum(one.sum() for one in many)) * names.get(how, 1)


def test_lists_and_dicts_of_one_kind_are_checked_once_and_of_several_kinds_each_time():
    function, made = remembered(total)
    for _ in range(2):
        assert function([np.ones(2), np.ones(2)], {"a": 1, "sum": 3}) == 12
        assert function([np.ones(2)], {"most": 2}, "most") == 4
    several = len(made)
    for wrong in (
        ([np.ones((2, 2))], {"a": 1}),
        ([np.ones(2, int)] * 2, {"a": 1}),
        ([np.ones(2)], {1: 1}),
        ([np.ones(2)], {"a": "1"}),
        ((np.ones(2),), {"a": 1}),
        ([np.ones(2)], {"a": 1}, "least"),
        ([np.ones(2)], {"a": 1}, ["sum"]),
    ):
        with pytest.raises(TypeCheckError):
            function(*wrong)
    for k in (1, 2):
        function([np.ones(2)], {"a": 1, "b": True})
        assert len(made) == several + 7 + k


def test_a_text_is_looked_at_itself_only_where_annotations_name_texts():
    (function, made), (other, made_too) = remembered(total), remembered(spelt)
    for text in ("sum", "most", "sum"):
        assert function([np.ones(2)], {"a": 1}, text) == 2
        assert other(text, b"0") == len(text) + 1
    assert (len(made), len(made_too)) == (2, 1)
    for wrong in ((b"sum", b"0"), ("sum", "0"), ("sum", bytearray(b"0"))):
        with pytest.raises(TypeCheckError):
            other(*wrong)


def spelt(text: str, content: bytes) -> int:
    return len(text) + len(content)


def scaling(k, checking, before=None):
    """Create a checked function by the same ``def`` each time; it may call an earlier one."""

    def scaled(one: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n"]:  # noqa: F821
        return k * one[0] if before is None else k * before(one)

    return remembering(scaled, checking)


def test_functions_that_another_defines_anew_are_checked_as_one_and_each_is_called():
    made = []

    def checking(function):
        inner = jaxtyped(function, typechecker=beartype)
        return lambda *args: made.append(args) or inner(*args)

    of = {k: scaling(k, checking) for k in (2, 3)}
    both = scaling(5, checking, of[3])
    assert np.array_equal(both(SQUARE), [15.0, 15.0])  # at the first call, too
    for k in (2, 3):
        assert np.array_equal(of[k](SQUARE), [k, k])
    assert len(made) == 2  # the two that began before either had ended
    for one in (*of.values(), both):
        for wrong in (np.ones((2, 3)), SQUARE.astype(int)):
            with pytest.raises(TypeCheckError):
                one(wrong)
    assert np.array_equal(both(SQUARE), [15.0, 15.0])
    with pytest.raises(TypeCheckError):
        scaling(1.0 + 0.0j, checking)(SQUARE)  # arguments as right as others, but not its result
