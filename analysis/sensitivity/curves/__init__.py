"""Values as exact functions of one parameter or two, with proofs: curves, maps, Blackwell."""
