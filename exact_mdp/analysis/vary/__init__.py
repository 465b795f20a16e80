"""Which numbers matter: derivatives, ranges, exact curves and thresholds, draws, worst cases."""
