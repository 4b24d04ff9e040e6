"""Every baseline on identical data, against the Cramér–Rao bound: the second part of the comparison of estimators."""
