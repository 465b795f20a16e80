"""Reports of the analyses of parameters: tornado, gradient, threshold, curve, psa and others."""
