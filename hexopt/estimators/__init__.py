"""Estimators: one algorithm a file, each a value with settings and one method, `fit`."""
