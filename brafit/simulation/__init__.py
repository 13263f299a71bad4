"""Clouds with a known truth: a simulated scanner, points on given surfaces."""
