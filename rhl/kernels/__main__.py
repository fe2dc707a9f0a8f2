"""Compile the loops now rather than at the first run: ``python -m rhl.kernels``, which ``make env`` calls."""

import numpy as np

import rhl
from rhl.losses import LogCosh

one = np.eye(1)
model = rhl.SignalModel(one, one)
rhl.solve(rhl.V1(model, Q=1.0, R=1.0, QN=1.0, weight=1.0, horizon=2), [1.0])
rhl.ProximalEstimator(window=1).minimise(model, np.ones((2, 1)), np.ones((1, 1)))
rhl.simulate(rhl.default_scheme(1, 1, order=1), rhl.LinearPlant(one, one, one), [1.0], steps=2)
rhl.ProximalEstimator(window=1, loss=LogCosh()).newton_decrement(model, model, np.zeros((2, 1)), np.ones((1, 1)))
