"""How networks of fixed size meet smaller and larger swarms."""

from math import comb

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from pipeline.networks.encoding import Encoding
from pipeline.networks.feedforward import FF1, combinations_of
from pipeline.orbit.problem import Problem

T = 3


def encoding(n):
    return Encoding(Problem(nodes=T), n, "line", "states", (1.0,) * 6, (1.0,) * 6)


class SumOfCraft(nn.Module):
    """Every craft's answer is the sum of all craft's inputs, node by node."""

    def __init__(self, n):
        super().__init__()
        self.n = n

    def forward(self, flat):
        matrix = flat.reshape(len(flat), self.n, T * 6)
        return matrix.sum(1, keepdim=True).expand_as(matrix).reshape(flat.shape)


def craft_inputs(values):
    return torch.tensor(values)[None, :, None, None].expand(1, -1, T, 6)


def test_a_smaller_swarm_is_padded_with_craft_at_rest_in_the_origin():
    answer = FF1.forward(SumOfCraft(10), craft_inputs([1.0, 2.0, 4.0]), encoding(10))
    assert answer.shape == (1, 3, T, 6)
    assert (answer == 7).all()


def test_a_swarm_of_the_training_s_size_is_asked_about_once():
    answer = FF1.forward(SumOfCraft(3), craft_inputs([1.0, 2.0, 4.0]), encoding(3))
    assert (answer == 7).all()


def test_a_larger_swarm_s_answer_is_the_mean_over_all_combinations():
    # Pairs of 1, 2, 4: craft 1 is in 1+2 and 1+4, craft 2 in 1+2 and 2+4, craft 4 in 1+4 and 2+4.
    answer = FF1.forward(SumOfCraft(2), craft_inputs([1.0, 2.0, 4.0]), encoding(2))
    assert torch.equal(answer[0, :, 0, 0], torch.tensor([4.0, 4.5, 5.5]))
    assert (answer == answer[:, :, :1, :1]).all()


def test_no_swarms_of_a_larger_size_have_no_answers():
    answer = FF1.forward(SumOfCraft(2), craft_inputs([1.0, 2.0, 3.0])[:0], encoding(2))
    assert answer.shape == (0, 3, T, 6)


def test_a_network_that_keeps_each_craft_to_itself_is_left_alone_by_padding_and_averaging():
    class Twice(nn.Module):
        def forward(self, flat):
            return 2 * flat

    for n in (1, 4, 10, 13, 57):
        inputs = torch.randn(2, n, T, 6)
        torch.testing.assert_close(FF1.forward(Twice(), inputs, encoding(10)), 2 * inputs)


@pytest.mark.parametrize(("n", "count"), [(10, 1), (11, 11), (12, 66), (13, 100), (30, 100)])
def test_all_combinations_are_used_up_to_a_hundred(n, count):
    assert len(combinations_of(n, 10)) == count


@settings(max_examples=60)
@given(st.integers(1, 12), st.integers(0, 150))
def test_combinations_are_distinct_and_hold_every_craft(size, more):
    n = size + more
    chosen = combinations_of(n, size)
    assert (np.diff(chosen, axis=1) > 0).all()  # no craft twice in one
    assert len({tuple(row) for row in chosen.tolist()}) == len(chosen)
    assert set(chosen.ravel().tolist()) == set(range(n))
    assert len(chosen) == min(comb(n, size), max(100, -(-n // size)))


def test_every_craft_of_a_swarm_too_large_for_a_hundred_combinations_is_in_one():
    assert set(combinations_of(1234, 10).ravel().tolist()) == set(range(1234))


def test_combinations_depend_on_the_swarm_s_size_alone():
    first = combinations_of(30, 10).copy()
    combinations_of.cache_clear()
    assert np.array_equal(first, combinations_of(30, 10))


def test_craft_are_in_nearly_equally_many_combinations():
    times = np.bincount(combinations_of(30, 10).ravel())
    assert times.max() - times.min() <= 2
