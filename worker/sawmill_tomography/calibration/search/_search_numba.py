"""Kernel of the search over the first angle."""

import math

import numpy as np
from numba import njit


@njit(cache=True, fastmath={"reassoc", "contract", "nsz"})
def best_turn(model, sinogram, first, data_sum, data_square, correlation, where):
    """Find the turn of the model's rotation table that correlates best with the data, for each choice of angles.

    model (turns, cells): projections at equidistant turns; sinogram (views, cells); first (choices, views): each view's
    angle in turns. Fills correlation (choices,) and where (choices,).
    """
    turns, cells = model.shape
    views = sinogram.shape[0]
    count = views * cells
    sums = np.zeros(turns)
    squares = np.zeros(turns)
    products = np.empty((views, turns))
    for j in range(turns):
        for m in range(cells):
            sums[j] += model[j, m]
            squares[j] += model[j, m] * model[j, m]
        for k in range(views):
            dot = 0.0
            for m in range(cells):
                dot += sinogram[k, m] * model[j, m]
            products[k, j] = dot
    for i in range(first.shape[0]):
        correlation[i] = -2.0
        where[i] = 0
        for turn in range(turns):
            dot, total, square = 0.0, 0.0, 0.0
            for k in range(views):
                j = (turn + first[i, k]) % turns
                dot += products[k, j]
                total += sums[j]
                square += squares[j]
            variance = (square - total * total / count) * (data_square - data_sum * data_sum / count)
            if variance > 0.0:
                value = (dot - total * data_sum / count) / math.sqrt(variance)
                if value > correlation[i]:
                    correlation[i] = value
                    where[i] = turn
