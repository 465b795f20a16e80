"""The laws of scipy that the distributions of parameters are."""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import stats

SCIPY_LAWS: dict[str, Callable[..., Any]] = {
    "beta": stats.beta,
    "normal": stats.norm,
    "gamma": lambda shape, scale: stats.gamma(shape, scale=abs(scale)),
    "lognormal": lambda mean, sd: stats.lognorm(sd, scale=np.exp(mean)),
    "uniform": lambda low, high: stats.uniform(low, high - low),
    "triangular": lambda a, mode, b: stats.triang((mode - a) / (b - a), a, b - a),
}
