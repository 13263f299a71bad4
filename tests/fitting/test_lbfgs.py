from __future__ import annotations

import pytest
import torch
from scipy.optimize import rosen, rosen_der

from brafit.fitting import adam
from brafit.fitting.lbfgs import minimise


def rosenbrock(x: torch.Tensor) -> torch.Tensor:
    return (100 * (x[:, 1:] - x[:, :-1] ** 2) ** 2 + (1 - x[:, :-1]) ** 2).sum(-1)


def beale(x: torch.Tensor) -> torch.Tensor:
    a, b = x[:, 0], x[:, 1]
    return (1.5 - a + a * b) ** 2 + (2.25 - a + a * b**2) ** 2 + (2.625 - a + a * b**3) ** 2


def ill_conditioned(x: torch.Tensor) -> torch.Tensor:
    stiffness = torch.logspace(0, 5, x.shape[1], dtype=x.dtype)
    return 1 + (stiffness * (x - 0.3) ** 2).sum(-1)


def barrier(x: torch.Tensor) -> torch.Tensor:
    """Not a number where x <= 0; minimum at 1."""
    return (x - torch.log(x)).sum(-1)


def with_gradient(function):
    def both(x: torch.Tensor, index: torch.Tensor | None = None) -> tuple[torch.Tensor, torch.Tensor]:
        x = x.detach().requires_grad_()
        value = function(x)
        return value.detach(), torch.autograd.grad(value.sum(), x)[0]

    return both


def test_rosenbrock_here_is_scipys():
    x = torch.randn(1, 6, dtype=torch.float64)
    value, gradient = with_gradient(rosenbrock)(x)
    assert value.item() == pytest.approx(rosen(x[0].numpy()))
    torch.testing.assert_close(gradient[0], torch.from_numpy(rosen_der(x[0].numpy())))


PROBLEMS = {
    "rosenbrock 2": (rosenbrock, torch.tensor([[-1.2, 1.0], [2.0, -2.0], [0.0, 3.0]]), 1.0),
    "rosenbrock 10": (rosenbrock, torch.linspace(0.5, 1.6, 30).view(3, 10), 1.0),
    "beale": (beale, torch.tensor([[1.0, 0.8], [2.0, -0.5], [0.0, 0.0]]), torch.tensor([3.0, 0.5])),
    "ill-conditioned": (ill_conditioned, torch.linspace(-2, 3, 36).view(3, 12), 0.3),
    "barrier": (barrier, torch.tensor([[0.01, 5.0], [0.5, 9.0], [1e-4, 0.9]]), 1.0),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_reaches_the_optimum(name):
    function, start, optimum = PROBLEMS[name]
    ending = minimise(with_gradient(function), start.double(), 600, tolerance=1e-15)
    assert ending.converged.all()
    assert not ending.diverged.any()
    expected = torch.as_tensor(optimum).double().expand_as(ending.place)
    torch.testing.assert_close(ending.place, expected, rtol=0, atol=1e-5)
    torch.testing.assert_close(ending.value, function(ending.place))


@pytest.mark.parametrize("name", PROBLEMS)
def test_each_problem_is_as_if_alone(name):
    function, start, _ = PROBLEMS[name]
    both = minimise(with_gradient(function), start.double(), 60)
    for k in range(len(start)):
        alone = minimise(with_gradient(function), start[k : k + 1].double(), 60)
        assert torch.equal(alone.place[0], both.place[k])
        assert alone.evaluations[0] == both.evaluations[k]
        assert alone.converged[0] == both.converged[k]


def broken(function, at_start: bool):
    """The function with problem 1 not a number: from the start, or everywhere but there."""
    calls = 0

    def both(x: torch.Tensor, index: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        nonlocal calls
        calls += 1
        value, gradient = with_gradient(function)(x)
        bad = (index == 1) & (at_start or calls > 1)
        return torch.where(bad, torch.nan, value), torch.where(bad[:, None], torch.inf, gradient)

    return both


@pytest.mark.parametrize("at_start", [True, False])
def test_a_problem_that_is_no_number_does_not_touch_the_others(at_start):
    start = PROBLEMS["rosenbrock 2"][1].double()
    healthy = minimise(with_gradient(rosenbrock), start, 60)
    ending = minimise(broken(rosenbrock, at_start), start, 60)
    assert ending.diverged.tolist() == [False, at_start, False]
    assert torch.equal(ending.place[1], start[1])
    for k in (0, 2):
        assert torch.equal(ending.place[k], healthy.place[k])
        assert ending.evaluations[k] == healthy.evaluations[k]


def test_converged_problems_are_frozen_and_no_longer_evaluated():
    seen = []

    def watched(x: torch.Tensor, index: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        seen.append(index.tolist())
        return with_gradient(rosenbrock)(x)

    start = torch.tensor([[1.0, 1.0], [-1.2, 1.0], [1.001, 1.0]], dtype=torch.float64)
    ending = minimise(watched, start, 300)
    counts = [sum(k in index for index in seen) for k in range(3)]
    assert ending.evaluations.tolist() == counts
    assert counts[0] < counts[2] < counts[1]
    assert seen[-1] == [1]
    assert ending.converged.all()
    assert torch.equal(ending.place[0], start[0])


def test_step_limit_is_not_convergence():
    start = PROBLEMS["rosenbrock 10"][1].double()
    seen: list[int] = []
    ending = minimise(with_gradient(rosenbrock), start, 5, callback=seen.append)
    assert seen == [0, 1, 2, 3, 4]
    assert not ending.converged.any()
    assert (ending.value < rosenbrock(start)).all()
    assert ending.evaluations.tolist() == [6, 6, 6]


def test_float32():
    function, start, _ = PROBLEMS["rosenbrock 2"]
    ending = minimise(with_gradient(function), start, 400)
    assert ending.place.dtype == torch.float32
    torch.testing.assert_close(ending.place, torch.ones(3, 2), rtol=0, atol=5e-3)


def test_adam_goes_down_and_keeps_the_best():
    start = PROBLEMS["rosenbrock 2"][1].double()
    seen: list[int] = []
    place, diverged = adam.descend(with_gradient(rosenbrock), start, 400, 0.1, callback=seen.append)
    assert not diverged.any()
    assert seen == list(range(400))
    assert (rosenbrock(place) < 0.05 * rosenbrock(start)).all()
    for k in range(3):
        alone, _ = adam.descend(with_gradient(rosenbrock), start[k : k + 1], 400, 0.1)
        assert torch.equal(alone[0], place[k])


def test_adam_returns_the_start_where_everything_else_is_worse():
    start = torch.ones(1, 2, dtype=torch.float64)
    place, _ = adam.descend(with_gradient(rosenbrock), start, 20, 0.5)
    assert torch.equal(place, start)
    place, _ = adam.descend(with_gradient(rosenbrock), start + 1, 0, 0.5)
    assert torch.equal(place, start + 1)


def test_adam_freezes_what_diverges():
    start = PROBLEMS["rosenbrock 2"][1].double()
    calls = 0

    def failing(x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        nonlocal calls
        calls += 1
        value, gradient = with_gradient(rosenbrock)(x)
        if calls > 10:
            value[1] = torch.nan
        return value, gradient

    place, diverged = adam.descend(failing, start, 100, 0.1)
    healthy, _ = adam.descend(with_gradient(rosenbrock), start, 100, 0.1)
    assert diverged.tolist() == [False, True, False]
    assert place.isfinite().all()
    assert rosenbrock(place)[1] < rosenbrock(start)[1]
    assert torch.equal(place[[0, 2]], healthy[[0, 2]])
