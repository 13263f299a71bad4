"""An item comes out the same to the last bit wherever it stands in a batch, and however large that is."""

import pytest
import torch
from torch.nn.functional import softplus

from brafit.geometry.products import apply, evenly

BATCHES = (1, 2, 3, 5, 8, 13, 31)


@pytest.mark.parametrize("rows", [201, 72, 48, 7])
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_a_product_does_not_depend_on_the_batch(rows, dtype):
    generator = torch.Generator().manual_seed(rows)
    matrix = torch.randn(rows, 128, generator=generator, dtype=dtype)
    values = torch.randn(31, 128, 3, generator=generator, dtype=dtype)
    whole = apply(matrix, values)
    assert torch.allclose(whole, matrix @ values, rtol=0, atol=1e-4)
    for size in BATCHES:
        for first in range(0, 31 - size + 1, size):
            assert torch.equal(apply(matrix, values[first : first + size].clone()), whole[first : first + size])


@pytest.mark.parametrize("function", [torch.sigmoid, softplus, torch.atan2], ids=["sigmoid", "softplus", "atan2"])
def test_a_function_does_not_depend_on_the_batch(function):
    generator = torch.Generator().manual_seed(3)
    count = 2 if function is torch.atan2 else 1
    values = [torch.randn(31, 7, 9, generator=generator, dtype=torch.float64) for _ in range(count)]
    whole = evenly(function, *values)
    assert torch.allclose(whole, function(*values), rtol=1e-14, atol=0)
    for size in BATCHES:
        for first in range(0, 31 - size + 1, size):
            part = evenly(function, *(v[first : first + size].clone() for v in values))
            assert torch.equal(part, whole[first : first + size])
