"""Numeric plant modules, one a law, and the sliding-mode law; written by `make generate`."""
