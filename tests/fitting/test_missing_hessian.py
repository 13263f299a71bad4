"""What is learnt of a Hessian from steps."""

import torch

from brafit.fitting.missing_hessian import MissingHessian
from brafit.fitting.normal import Normal
from brafit.geometry.panels import Feet


def model(value: torch.Tensor, gradient: torch.Tensor, matrix: torch.Tensor) -> Normal:
    none = value.new_zeros(len(value), 0)
    return Normal(value, gradient, matrix, {}, Feet(none.long(), none.long(), none, none))


def walk(hessian: torch.Tensor, known: torch.Tensor, steps: torch.Tensor) -> MissingHessian:
    """Steps on quadratic forms of which only the known part is in the models."""
    place = torch.zeros_like(hessian[..., 0])
    value = lambda x: 0.5 * torch.einsum("bi,bij,bj->b", x, hessian, x)  # noqa: E731
    gradient = lambda x: torch.einsum("bij,bj->bi", hessian, x)  # noqa: E731
    here = model(value(place), gradient(place), known)
    missing = MissingHessian.none(here)
    for step in steps:
        place = place + step
        there = model(value(place), gradient(place), known)
        missing = missing.learnt(here, there, step, torch.ones(len(step), dtype=torch.bool))
        here = there
    return missing


def forms(batch: int = 3, n: int = 5, lacking: float = 0.5) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    a, b = torch.randn(2, batch, n, n, generator=generator, dtype=torch.float64)
    known = a @ a.mT + n * torch.eye(n, dtype=torch.float64)
    steps = torch.randn(40, batch, n, generator=generator, dtype=torch.float64)
    return known + lacking * (b + b.mT), known, steps


def test_the_last_step_is_foretold_by_what_was_learnt():
    """The secant equation: Gauss-Newton matrix and what it lacks together turn the step into the gradient's change."""
    hessian, known, steps = forms()
    for count in (1, 2, 5):
        matrix = known + walk(hessian, known, steps[:count]).matrix
        last = steps[count - 1][..., None]
        assert torch.allclose(matrix @ last, hessian @ last, rtol=0, atol=1e-9)
        assert torch.allclose(matrix, matrix.mT, rtol=0, atol=1e-12)


def test_most_of_what_is_missing_is_found_in_the_end():
    hessian, known, steps = forms()
    before = (hessian - known).norm(dim=(1, 2))
    found = walk(hessian, known, steps)
    assert ((hessian - known - found.matrix).norm(dim=(1, 2)) < 0.6 * before).all()
    assert found.trusted.all()


def test_where_nothing_is_missing_nothing_is_learnt():
    _, known, steps = forms()
    assert walk(known, known, steps).matrix.abs().max() < 1e-9


def test_a_refused_step_teaches_nothing_even_if_it_led_nowhere():
    _, known, steps = forms()
    start = steps.new_zeros(3)
    here = model(start, steps.new_zeros(3, 5), known)
    lost = model(start + torch.nan, steps.new_full((3, 5), torch.nan), known * torch.nan)
    missing = MissingHessian.none(here).learnt(here, lost, steps[0], torch.zeros(3, dtype=torch.bool))
    assert (missing.matrix == 0).all()
    assert missing.trusted.all()
