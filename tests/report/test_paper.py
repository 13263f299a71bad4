import numpy as np
import pytest
from lunes import lune_cup, lune_flat

from brafit.report.paper import paper_gap, paper_panels


@pytest.mark.parametrize("panels", [1, 2, 3])
def test_folded_patterns_are_the_cup(panels):
    """Facets are chords: their gap shrinks with the square of their width."""
    coarse, fine = (
        paper_gap(lune_cup(panels, n), paper_panels(lune_cup(panels, n), lune_flat(panels, n))) for n in (51, 201)
    )
    assert fine < 0.005
    assert coarse / fine == pytest.approx(16, rel=0.2)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_folding_changes_no_length(share):
    for paper in paper_panels(lune_cup(2), lune_flat(2)):
        lower, upper = paper.folded(share)
        for folded, flat in ((lower, paper.lower), (upper, paper.upper)):
            steps, wanted = (np.linalg.norm(np.diff(line, axis=0), axis=1) for line in (folded, flat))
            np.testing.assert_allclose(steps, wanted, atol=1e-10)
        np.testing.assert_allclose(
            np.linalg.norm(upper - lower, axis=1), np.linalg.norm(paper.upper - paper.lower, axis=1), atol=1e-10
        )
        diagonals = np.linalg.norm(upper[1:] - lower[:-1], axis=1)
        np.testing.assert_allclose(diagonals, np.linalg.norm(paper.upper[1:] - paper.lower[:-1], axis=1), atol=1e-10)


def test_unfolded_is_flat_and_folding_bends_it():
    (paper,) = paper_panels(lune_cup(1), lune_flat(1))
    depth = []
    for share in (0.0, 0.5, 1.0):
        points = np.concatenate(paper.folded(share))
        depth.append(np.linalg.svd(points - points.mean(0))[1][2])
    assert depth[0] < 1e-9
    assert depth[0] < depth[1] < depth[2]


def test_several_shares_at_once():
    shares = np.array((0.0, 0.25, 1.0))
    for paper in paper_panels(lune_cup(3), lune_flat(3)):
        for share, fold in zip(shares, paper.folds(shares), strict=True):
            np.testing.assert_allclose(fold, np.stack(paper.folded(float(share))), atol=1e-10)
