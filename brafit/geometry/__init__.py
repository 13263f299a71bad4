"""Differential geometry of curves and developable panels: pure functions on tensors.

Functions of tensors take any leading batch shape, float32 or float64, on any device, and can be differentiated. Not
differentiated are the searches for nearest points (`nearest`, whose distances have derivatives all the same). `order`,
`polyline`, `smoothing`, `EdgeCurvature` and the Chebyshev operators of `grid` work on NumPy arrays; `traced` is float64
on the CPU. Numbers in parentheses, as in "(12)", are equations of docs/formulation.md.

    rotation      exponential map of SO(3) and SE(3)
    ritz          bases for the unknown functions of arc length
    grid          differentiation, integration and interpolation on sampled functions
    curve         moving frames and curves integrated as an associative scan
    developable   rulings, rib angle, twist, regularity of a ruled panel
    strip         a developable panel built on an edge, and the edge that it makes
    panels        places on a chain of panels, as sums of samples of the edges
    nearest       nearest point on a chain of panels, with envelope gradients; `foot`: on a given panel
    hermite       curves between samples
    moving        nearest points that move with cup and points, for second derivatives
    development   the panel laid flat
    fairness      how quickly the curvature of flat edges changes
    polyline      length, even spacing, distances of polylines; `rigid`: points laid on points
    smoothing     smooth curves near polylines; `traced`: the same, differentiable
    products      matrix products that are the same for an item alone and in a batch
    order         points in the order of a curve that fills space
"""
