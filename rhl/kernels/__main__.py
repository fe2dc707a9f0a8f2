"""Compile the loops before the first run: ``python -m rhl.kernels``, which ``make env`` calls."""

import numpy as np

import rhl

one, two = np.eye(1), rhl.SignalModel(np.eye(2), np.ones((2, 1)))
x, u = np.zeros((2, 2)), np.ones((1, 1))
rhl.solve(rhl.V1(two, Q=1.0, R=1.0, QN=1.0, weight=1.0, horizon=2), x[0])
rhl.ProximalEstimator(window=1).newton_decrement(rhl.ProximalEstimator(window=1).minimise(two, x, u), two, x, u)
for scheme in (rhl.window_scheme(1, 1, order=1), rhl.default_scheme(1, 1, order=1)):
    rhl.simulate(scheme, rhl.LinearPlant(one, one, one), [1.0], steps=2)
