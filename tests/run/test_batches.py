"""How a dataset is parted into batches: small ones cost more a scan, few ones leave workers without a fit."""

from __future__ import annotations

import pytest

from brafit.run.conductor import LEAST, batch_size, last_size


@pytest.mark.parametrize(("count", "sizes"), [(14, (7, 7)), (112, (56, 56)), (56, (28, 28)), (57, (29, 28)), (7, (7,))])
def test_every_worker_has_a_fit(count: int, sizes: tuple[int, ...]) -> None:
    left = count
    for size in sizes:
        assert min(left, batch_size(count, 56, 2)) == size
        left -= size
    assert left == 0


def parted(left: int, share: int, idle: list[int]) -> list[int]:
    """Sizes of the last batches, if so many workers fit nothing when each is taken."""
    sizes = []
    for count in idle:
        if left:
            sizes.append(min(left, last_size(left, share, count)))
            left -= sizes[-1]
    assert left == 0
    return sizes


def test_what_is_left_is_parted_among_the_idle_and_no_further() -> None:
    assert parted(56, 28, [1, 2, 1]) == [28, 14, 14]
    assert parted(56, 28, [1, 1]) == [28, 28]
    assert parted(14, 7, [2, 1]) == [7, 7]
    assert parted(28, 28, [3, 2, 1]) == [10, 9, 9]


def test_batches_of_few_scans_are_not_made() -> None:
    assert parted(2 * LEAST - 1, 56, [2]) == [2 * LEAST - 1]
    assert parted(2 * LEAST, 56, [2, 1]) == [LEAST, LEAST]
