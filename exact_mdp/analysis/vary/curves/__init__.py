"""Values as exact functions of one parameter, with proofs."""
