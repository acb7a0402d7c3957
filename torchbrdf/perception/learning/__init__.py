"""A metric learned from answers: training sets and training."""
