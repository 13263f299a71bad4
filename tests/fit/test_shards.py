from __future__ import annotations

import threading

import pytest
import torch

from brafit.fit.shards import in_shards
from brafit.fit.solver import Step


@pytest.mark.parametrize("count", [1, 2, 3, 9])
def test_results_come_in_the_items_order(count):
    seen = []

    def work(items, callback):
        seen.append((list(items), threading.get_ident(), torch.get_num_threads()))
        return [10 * item for item in items]

    items = list(range(7))
    assert in_shards(work, items, count) == [10 * k for k in items]
    assert sorted(k for part, _, _ in seen for k in part) == items
    assert len(seen) == min(count, 7)


def test_the_callback_hears_of_all_shards_as_far_as_the_slowest_has_come():
    both, told = threading.Barrier(2), []

    def work(items, callback):
        for index in range(3 if items[0] == 0 else 5):
            both.wait() if index == 0 else None
            callback(Step("only", index, 5, {"objective": torch.tensor([float(v) for v in items])}))
        return list(items)

    in_shards(work, [0, 1, 2, 3], 2, told.append)
    assert [step.index for step in told] == sorted({step.index for step in told})
    assert told[-1].index == 4
    assert sorted(told[0].terms["objective"].tolist()) == [0, 1, 2, 3]


def test_an_error_in_one_shard_is_raised():
    def work(items, callback):
        if 3 in items:
            raise RuntimeError("shard")
        return list(items)

    with pytest.raises(RuntimeError, match="shard"):
        in_shards(work, [0, 1, 2, 3], 2, lambda step: None)
