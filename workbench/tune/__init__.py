"""Tunings found by global scan, refined by nonlinear programming, verified by exact simulation."""
