"""Estimators on identical data: the convex family against the paper's least squares."""
