"""Vectors against the plain numbers that they stand for."""

import math

import numpy as np
import pytest

from rover_ncp.kernels.jit import kernel, without_refcounts
from rover_ncp.kernels.vectors import (
    WIDTH,
    everywhere,
    gather,
    larger,
    load,
    load_lanes,
    scatter,
    smaller,
    store_lanes,
    where_less,
)

SPECIAL = [-math.inf, -1.5, -0.0, 0.0, 2.0, math.inf, math.nan]


@kernel
def copy_lanes(source, target):
    for row in range(len(source)):
        for start in range(0, source.shape[1], WIDTH):
            store_lanes(target, row, start, load_lanes(source, row, start) + everywhere(0.5))


@kernel
def eight_lanes(source, start, target):
    store_lanes(target, 0, 0, load_lanes(source, 1, start))


@kernel
def compare(a, b, found):
    first, second = load(a, 0, 0), load(b, 0, 0)
    store_lanes(found, 0, 0, larger(first, second))
    store_lanes(found, 1, 0, smaller(first, second))
    store_lanes(found, 2, 0, where_less(first, second, 1.0, first))


@kernel
def swap(addresses, offset):
    there = gather(addresses, 8, offset)
    scatter(addresses, 8, offset, gather(addresses, 0, offset))
    scatter(addresses, 0, offset, there)


@kernel
def add_up(pair, number):
    pair, number = without_refcounts(pair), without_refcounts(number)
    return pair[0][1].sum() + pair[1] + number


@pytest.mark.parametrize("width", [1, 4, 8, 11, 16])
def test_lanes_are_copied_as_far_as_there_are_any(width):
    source, memory = np.random.default_rng(width).normal(size=(3, width)), np.full(3 * width + WIDTH, -7.0)
    target = memory[: 3 * width].reshape(3, width)
    copy_lanes(source, target)
    assert (memory[3 * width :] == -7.0).all()
    assert np.array_equal(target, source + 0.5)
    eight = np.zeros((1, WIDTH))
    start = (width - 1) // WIDTH * WIDTH
    eight_lanes(source, start, eight)
    last = source[1, start:]
    assert np.array_equal(eight[0], np.pad(last, (0, WIDTH - len(last)), mode="edge"))


def test_the_larger_and_the_smaller_are_those_of_python():
    for a in SPECIAL:
        b = np.resize(SPECIAL, WIDTH)
        found = np.zeros((3, WIDTH))
        compare(np.full((1, 1, WIDTH), a), b.reshape(1, 1, WIDTH), found)
        expected = [
            [max(a, x) for x in b],
            [min(a, x) for x in b],
            [1.0 if a < x else a for x in b],
        ]
        assert found.tobytes() == np.array(expected).tobytes()


def test_numbers_behind_addresses_are_gathered_and_scattered():
    memory = np.random.default_rng(0).normal(size=(16, 3))
    expected = np.concatenate([memory[8:], memory[:8]])[:, 1]
    swap(memory.ctypes.data + 24 * np.arange(16), 8)
    assert np.array_equal(memory[:, 1], expected)


def test_array_without_refcounts_is_unchanged():
    row = np.arange(4.0)
    assert add_up(((row, row + 1.0), 5), 0.25) == 15.25
    assert row.tolist() == [0.0, 1.0, 2.0, 3.0]
