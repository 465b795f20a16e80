"""Many draws of the parameters, each solved: in blocks, in threads, by design."""
