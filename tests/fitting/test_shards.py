from __future__ import annotations

import os
from functools import partial

import numpy as np
import pytest
from lunes import lune_cup, sphere_points

from brafit.cup import StripsCup
from brafit.fitting import LM, Conditions, CupFit, LMStage, Target, fit_targets

CUP = partial(StripsCup, panels=2, terms=4, stations=21, nodes=24, output_nodes=24)
SOLVER = LM([LMStage(steps=4, terms=3, points=0), LMStage(steps=6)])
CONDITIONS = Conditions(neckline=0.1)


def dies(survivor: int, wire):
    """The cup of a process that falls as soon as it has work."""
    if os.getpid() != survivor:
        os._exit(1)
    return CUP(wire)


def targets(count: int) -> list[Target]:
    """Parts of spheres of growing size."""
    points, shape = sphere_points(150)[0], lune_cup(2, 41)
    wire, line = shape.edges[0].numpy(), shape.edges[-1].numpy()
    return [Target(f"{k}", points * (1 + k / 50), wire * (1 + k / 50), line * (1 + k / 50)) for k in range(count)]


def fitted(some: list[Target], threads: int, **given) -> list[CupFit]:
    return fit_targets(some, given.pop("cup", CUP), SOLVER, CONDITIONS, threads=threads, **given)


@pytest.fixture(scope="module")
def alone() -> list[CupFit]:
    return fitted(targets(9), 1)


@pytest.mark.parametrize("threads", [2, 5])
def test_results_are_those_of_one_process_in_the_same_order(threads, alone):
    for own, fit in zip(fitted(targets(9), threads), alone, strict=True):
        assert own.name == fit.name
        np.testing.assert_allclose(own.shape.edges, fit.shape.edges, rtol=0, atol=1e-7)
        assert own.figures["rms_mm"] == pytest.approx(fit.figures["rms_mm"], rel=1e-9)


def test_the_callback_hears_of_all_shards_as_far_as_the_slowest_has_come():
    told = []
    fitted(targets(8), 2, callback=told.append)
    assert len(told) > 5
    indices = [step.index for step in told]
    assert indices == sorted(set(indices))
    # of both shards, less what the one that is ahead has finished
    assert 4 < max(len(step.terms["objective"]) for step in told) <= 8


def test_an_error_elsewhere_is_raised_here_and_the_process_serves_on(alone):
    bad = targets(8)
    bad[7] = Target("bent", bad[7].points, np.zeros((3, 3)))
    with pytest.raises(ValueError, match="at least 4 distinct points"):
        fitted(bad, 2)
    assert [fit.name for fit in fitted(targets(8), 2)] == [fit.name for fit in alone[:8]]


def test_what_cannot_be_sent_is_done_here(alone):
    fits = fitted(targets(8), 2, cup=lambda wire: CUP(wire))
    assert [fit.figures["rms_mm"] for fit in fits] == pytest.approx([fit.figures["rms_mm"] for fit in alone[:8]])


def test_the_share_of_a_process_that_died_is_done_here(alone):
    dying = fitted(targets(8), 2, cup=partial(dies, os.getpid()))
    assert [fit.name for fit in dying] == [fit.name for fit in alone[:8]]
