"""Differential geometry of curves and developable panels: pure functions on tensors.

Every function takes any leading batch shape, float32 or float64, on any device, and differentiates.

    rotation      exponential map of SO(3) and SE(3)
    ritz          bases for the unknown functions of arc length
    grid          differentiation, integration and interpolation on sampled functions
    curve         moving frames and curves integrated as an associative scan
    developable   omega from two edges, rib angle, twist, regularity of a ruled panel
    nearest       nearest point on a chain of panels, with envelope gradients
    development   the panel laid flat
    order         points in the order of a curve that fills space
"""
