"""Objectives for solvers from plain functions."""


class FromFunction:
    """The objective whose values, gradients and, if it gives them, matrices a function of (x, rows) gives."""

    def __init__(self, function):
        self.function = function

    def value_and_gradient(self, x, rows):
        return self.function(x, rows)[:2]

    def quadratic_model(self, x, rows):
        return self.function(x, rows)
